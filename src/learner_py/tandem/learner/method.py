"""A method as functions: its configuration (head, critic, improvement, decision) turned into the four things that
training needs. Everything that depends on a choice is decided here and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from tandem.learner.buffer import Arrays
from tandem.learner.config import LearnerScenario, MethodConfig
from tandem.learner.critic import mc_loss, mean_score
from tandem.learner.episode import Bools, Episode
from tandem.learner.improvement import imitation_loss, max_q_target
from tandem.learner.networks import Array, Mlp, actor_chunk, init_ensemble, init_mlp
from tandem.learner.windows import Windows, make_windows


class LearnerState(NamedTuple):
    """All that gradient updates change. A checkpoint holds every leaf of it."""

    actor: Mlp
    actor_average: Mlp  # EMA of the actor: what is deployed and evaluated
    critic: Mlp  # leading axis M; empty without a critic
    actor_optimizer: optax.OptState
    critic_optimizer: optax.OptState
    updates: Array  # int32, gradient updates so far


class Batch(NamedTuple):
    x: Array  # (B, O) normalised observations
    chunk: Array  # (B, h, A) executed
    valid: Array  # (B, h)
    human: Array  # (B, h)
    mc_return: Array  # (B,)


@dataclass(frozen=True)
class Method:
    scenario: LearnerScenario

    @property
    def config(self) -> MethodConfig:
        return self.scenario.method

    @property
    def has_critic(self) -> bool:
        return self.config.learner.critic.kind == "mc"

    def init(self, seed: int) -> LearnerState:
        learner, task = self.config.learner, self.scenario.task
        n_obs, n_chunk = len(task.observation), self.config.horizon * len(task.action_axes)
        generator = np.random.default_rng(seed)
        head, critic_config = learner.head, learner.critic
        # a small output layer: the first actions are near zero, which is "hold"
        actor = init_mlp(generator, [n_obs, *head.hidden, n_chunk], head.layer_norm, output_gain=0.1)
        sizes = [n_obs + n_chunk, *critic_config.hidden, 1]
        critic = init_ensemble(generator, critic_config.members, sizes) if self.has_critic else []
        return LearnerState(
            actor=actor,
            actor_average=jax.tree.map(jnp.copy, actor),
            critic=critic,
            actor_optimizer=self.optimizer().init(actor),
            critic_optimizer=self.optimizer().init(critic),
            updates=jnp.int32(0),
        )

    def optimizer(self) -> optax.GradientTransformation:
        return optax.adam(self.config.learner.learning_rate)

    # ---- data

    def windows(self, episode: Episode) -> Windows:
        cut = self.has_critic and self.config.learner.critic.cut_return_at_intervention
        return make_windows(
            episode, self.scenario.action_columns, self.config.horizon, self.config.discount, cut
        )

    def eligible(self, episode: Episode, windows: Windows) -> Bools:
        """(T,) rows of an episode that minibatches may hold."""
        data = self.config.learner.improvement.data
        if data == "demonstrations":
            return np.full(episode.n_steps, episode.is_demonstration)
        return windows.human[:, 0] if data == "human" else np.ones(episode.n_steps, bool)

    def batch(self, arrays: Arrays, rows: Array, mean: Array, scale: Array) -> Batch:
        """Gathers buffer rows (B,)."""
        return Batch(
            x=(arrays["observation"][rows] - mean) * scale,
            chunk=arrays["chunk"][rows],
            valid=arrays["valid"][rows],
            human=arrays["human"][rows],
            mc_return=arrays["mc_return"][rows],
        )

    # ---- the policy

    def act(self, actor: Mlp, x: Array) -> Array:
        """Head and decision: normalised observations (B, O) -> chunks (B, h, A)."""
        return actor_chunk(actor, x, self.config.learner.head.activation, self.config.horizon)

    # ---- losses

    def critic_loss(self, critic: Mlp, batch: Batch) -> tuple[Array, Array]:
        """Loss and ranking score (B,) of the buffer's chunks."""
        return mc_loss(critic, batch.x, batch.chunk, batch.mc_return)

    def actor_loss(
        self, actor: Mlp, critic: Mlp, batch: Batch, q_buffer: Array, warm_start: Array
    ) -> tuple[Array, Array]:
        """Loss and policy_wins (B,). warm_start: imitate the batch, the critic is too young to rank."""
        chunk = self.act(actor, batch.x)
        improvement = self.config.learner.improvement
        # the human's own steps only, when only those are to be imitated; a window may run into autonomous ones
        mask = batch.human if improvement.data == "human" else batch.valid
        if improvement.kind == "imitate":
            return imitation_loss(chunk, batch.chunk, mask), jnp.zeros(len(chunk), bool)
        q_policy = mean_score(critic, batch.x, jax.lax.stop_gradient(chunk))
        target, policy_wins = max_q_target(q_policy, q_buffer, chunk, batch.chunk)
        target = jnp.where(warm_start, batch.chunk, target)
        return imitation_loss(chunk, target, mask), policy_wins
