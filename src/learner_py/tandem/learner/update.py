"""Many gradient updates in one jitted call: draw a minibatch, improve the critic, improve the actor, average the actor.

The number of updates in a call is an argument, not a shape, so everything is compiled once per buffer allocation.
Update i of an episode draws its minibatch with the key (seed, episode, i): the parameters depend on neither how the
updates were grouped into calls nor where a run was interrupted.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import optax
from jax import lax

from tandem.learner.buffer import Arrays
from tandem.learner.method import LearnerState, Method
from tandem.learner.networks import Array

Sums = dict[str, Array]  # sums over the updates of one call, float32
Update = Callable[..., tuple[LearnerState, Sums]]

SUM_NAMES = ("critic_loss", "actor_loss", "human", "autonomous", "human_wins", "autonomous_wins")


def make_update(method: Method) -> Update:
    """Returns update(state, arrays, rows, n_rows, mean, scale, key, start, stop, warm_start) -> (state, sums).

    arrays, rows, n_rows: the buffer's. mean, scale (O,): the normaliser's. key: of the episode. Runs updates
    start .. stop-1. The state is donated: the caller's old one is gone afterwards.
    """
    learner = method.config.learner
    optimizer = method.optimizer()

    def one_update(
        state: LearnerState, arrays: Arrays, rows: Array, mean: Array, scale: Array, warm_start: Array
    ) -> tuple[LearnerState, Sums]:
        batch = method.batch(arrays, rows, mean, scale)

        # critic and actor step from the same parameters: the critic's forward pass is also the ranking of the buffer
        critic, critic_optimizer = state.critic, state.critic_optimizer
        critic_loss, q_buffer = jnp.float32(jnp.nan), jnp.zeros(len(rows))
        if method.has_critic:
            (critic_loss, q_buffer), gradient = jax.value_and_grad(method.critic_loss, has_aux=True)(
                critic, batch
            )
            step, critic_optimizer = optimizer.update(gradient, critic_optimizer)
            critic = optax.apply_updates(critic, step)

        (actor_loss, wins), gradient = jax.value_and_grad(method.actor_loss, has_aux=True)(
            state.actor, state.critic, batch, q_buffer, warm_start
        )
        step, actor_optimizer = optimizer.update(gradient, state.actor_optimizer)
        actor = optax.apply_updates(state.actor, step)

        # a young average follows quickly, so that it forgets the random start
        decay = jnp.minimum(learner.ema, (1.0 + state.updates) / (10.0 + state.updates))
        average = jax.tree.map(lambda old, new: decay * old + (1.0 - decay) * new, state.actor_average, actor)

        human = batch.human[:, 0]
        sums = {
            "critic_loss": critic_loss / learner.critic.members,
            "actor_loss": actor_loss,
            "human": human.sum(dtype=jnp.float32),
            "autonomous": (~human).sum(dtype=jnp.float32),
            "human_wins": (wins & human).sum(dtype=jnp.float32),
            "autonomous_wins": (wins & ~human).sum(dtype=jnp.float32),
        }
        new = LearnerState(actor, average, critic, actor_optimizer, critic_optimizer, state.updates + 1)
        return new, sums

    def update(
        state: LearnerState,
        arrays: Arrays,
        rows: Array,
        n_rows: Array,
        mean: Array,
        scale: Array,
        key: Array,
        start: Array,
        stop: Array,
        warm_start: Array,
    ) -> tuple[LearnerState, Sums]:
        def body(index: Array, carry: tuple[LearnerState, Sums]) -> tuple[LearnerState, Sums]:
            state, total = carry
            # the remainder favours low rows by n_rows / 2^32, which is nothing
            bits = jax.random.bits(jax.random.fold_in(key, index), (learner.batch,), jnp.uint32)
            drawn = rows[bits % n_rows.astype(jnp.uint32)]
            state, sums = one_update(state, arrays, drawn, mean, scale, warm_start)
            return state, jax.tree.map(jnp.add, total, sums)

        zero = {name: jnp.float32(0) for name in SUM_NAMES}
        return lax.fori_loop(start, stop, body, (state, zero))

    return jax.jit(update, donate_argnums=0)
