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

from tandem.learner.buffer import Arrays, RowSet, RowSets
from tandem.learner.critic import mean_score
from tandem.learner.method import LearnerState, Method, Networks
from tandem.learner.networks import Array

Sums = dict[str, Array]  # sums over the updates of one call, float32
Update = Callable[..., tuple[LearnerState, Sums]]

SUM_NAMES = (
    "critic_loss",
    "actor_loss",
    "actor_updates",
    "human",
    "autonomous",
    "human_wins",
    "autonomous_wins",
)


def make_update(method: Method) -> Update:
    """Returns update(state, arrays, sets, mean, scale, key, start, stop, warm_start) -> (state, sums).

    arrays, sets: the buffer's. mean, scale (O,): the normaliser's. key: of the episode. Runs updates
    start .. stop-1. The state is donated: the caller's old one is gone afterwards.
    """
    learner = method.config.learner
    replay, batch_size = learner.replay, method.scenario.batch

    def rows_of(sets: RowSets, key: Array) -> Array:
        """Rows (B,) for critic and actor."""
        drawn, left = [], batch_size
        for index, (name, share) in enumerate(method.draws.items()):
            n = left if index == len(method.draws) - 1 else round(share * batch_size)
            left -= n
            rows = _draw(sets[name], n, jax.random.fold_in(key, index), replay.half_life)
            if name == "online":  # nothing has come yet, in the warm start
                rows = jnp.where(sets["online"].n > 0, rows, _draw(sets["prior"], n, key, 0))
            drawn.append(rows)
        return jnp.concatenate(drawn)

    def one_update(
        state: LearnerState,
        arrays: Arrays,
        sets: RowSets,
        mean: Array,
        scale: Array,
        key: Array,
        warm_start: Array,
    ) -> tuple[LearnerState, Sums]:
        key_rows, key_critic, key_imitated, key_actor = jax.random.split(key, 4)
        batch = method.batch(arrays, rows_of(sets, key_rows), mean, scale, key_critic)

        # critic and actor step from the same parameters: the critic's forward pass is also the ranking of the buffer
        encoder_gradients: list[Networks] = []  # of all that look through it
        critics, critic_optimizer = state.critics, state.critic_optimizer
        critic_loss, q_buffer = jnp.float32(jnp.nan), jnp.zeros(batch_size)
        if method.has_critic:
            loss_of = jax.value_and_grad(method.critic_loss, argnums=(0, 1), has_aux=True)
            (critic_loss, q_buffer), (gradient, of_encoder) = loss_of(
                state.critics, state.encoder, state, batch, key_critic
            )
            encoder_gradients.append(of_encoder)
            step, critic_optimizer = method.critic_optimizer.update(gradient, critic_optimizer, critics)
            critics = optax.apply_updates(critics, step)

        if method.imitates_other_rows:
            rows = _draw(sets["imitated"], batch_size, key_imitated, replay.half_life)
            batch = method.batch(arrays, rows, mean, scale, key_imitated)
            x = method.seen(state.encoder, batch).x
            q_buffer = mean_score(state.critics["critic"], x, batch.chunk, learner.critic.activation)

        def improve() -> tuple[Networks, optax.OptState, Networks, Array, Array]:
            loss_of = jax.value_and_grad(method.actor_loss, argnums=(0, 1), has_aux=True)
            (loss, wins), (gradient, of_encoder) = loss_of(
                state.actors, state.encoder, state, batch, q_buffer, key_actor, warm_start
            )
            step, actor_optimizer = method.actor_optimizer.update(gradient, state.actor_optimizer)
            return optax.apply_updates(state.actors, step), actor_optimizer, of_encoder, loss, wins

        def rest() -> tuple[Networks, optax.OptState, Networks, Array, Array]:
            nothing = jax.tree.map(jnp.zeros_like, state.encoder)
            return state.actors, state.actor_optimizer, nothing, jnp.float32(0), jnp.zeros(batch_size, bool)

        every = learner.updates_per_actor_update
        is_due = (state.updates % every == every - 1) | warm_start
        actors, actor_optimizer, of_encoder, actor_loss, wins = (
            improve() if every == 1 else lax.cond(is_due, improve, rest)
        )

        encoder, encoder_optimizer = state.encoder, state.encoder_optimizer
        if method.sight is not None:
            gradient = jax.tree.map(lambda *parts: sum(parts), *encoder_gradients, of_encoder)
            step, encoder_optimizer = method.actor_optimizer.update(gradient, encoder_optimizer)
            encoder = optax.apply_updates(encoder, step)

        human = batch.human[:, 0]
        counted = jnp.float32(1) if every == 1 else is_due.astype(jnp.float32)
        sums = {
            "critic_loss": critic_loss / learner.critic.members,
            "actor_loss": actor_loss,
            "actor_updates": counted,
            "human": counted * human.sum(),
            "autonomous": counted * (~human).sum(),
            "human_wins": (wins & human).sum(dtype=jnp.float32),
            "autonomous_wins": (wins & ~human).sum(dtype=jnp.float32),
        }
        average = method.averages(state, {**actors, **critics, **encoder}, warm_start)
        new = LearnerState(
            critics,
            actors,
            average,
            critic_optimizer,
            actor_optimizer,
            state.updates + 1,
            encoder,
            encoder_optimizer,
        )
        return new, sums

    def update(
        state: LearnerState,
        arrays: Arrays,
        sets: RowSets,
        mean: Array,
        scale: Array,
        key: Array,
        start: Array,
        stop: Array,
        warm_start: Array,
    ) -> tuple[LearnerState, Sums]:
        def body(index: Array, carry: tuple[LearnerState, Sums]) -> tuple[LearnerState, Sums]:
            state, total = carry
            state, sums = one_update(
                state, arrays, sets, mean, scale, jax.random.fold_in(key, index), warm_start
            )
            return state, jax.tree.map(jnp.add, total, sums)

        zero = {name: jnp.float32(0) for name in SUM_NAMES}
        return lax.fori_loop(start, stop, body, (state, zero))

    return jax.jit(update, donate_argnums=0)


def _draw(rows: RowSet, n: int, key: Array, half_life: int) -> Array:
    """n rows of a set, each as likely; with a half-life one that came so many rows earlier is half as likely."""
    if half_life == 0:
        # the remainder favours low rows by count / 2^32, which is nothing
        return rows.listed[jax.random.bits(key, (n,), jnp.uint32) % rows.n.astype(jnp.uint32)]
    count = rows.n.astype(jnp.float32)
    oldest = 1.0 - 2.0 ** (-count / half_life)
    age = -half_life * jnp.log2(1.0 - oldest * jax.random.uniform(key, (n,)))
    return rows.listed[jnp.clip(rows.n - 1 - age.astype(jnp.int32), 0, rows.n - 1)]
