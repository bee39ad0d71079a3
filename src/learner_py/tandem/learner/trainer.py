"""The training itself, without processes or messages: episodes in order go in, parameters and policy files come out.

    trainer.ingest(episode)      into the buffer
    trainer.train(episode, ...)  the updates that this episode pays for
    trainer.write_policy(path)   what the arm will run

How many updates an episode pays for depends on step counts alone, never on time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from tandem.images import Pixels
from tandem.learner import checkpoint
from tandem.learner.buffer import ReplayBuffer
from tandem.learner.checkpoint import Position
from tandem.learner.config import LearnerScenario
from tandem.learner.episode import Episode, Floats
from tandem.learner.golden import RANGE, golden_examples
from tandem.learner.method import LearnerState, Method
from tandem.learner.normalizer import Normalizer
from tandem.learner.update import make_update
from tandem.policy_file import PolicyHeader, WrittenFile, write_policy

BLOCK = 64  # updates in one call: short enough that a status follows within a second
GOLDEN_REAL, GOLDEN_RANDOM = 8, 8


@dataclass(frozen=True)
class Report:
    """Means over one call of the update (NaN where there is nothing to average)."""

    n_updates: int
    seconds: float
    critic_loss: float
    actor_loss: float
    win_share: float
    win_share_human: float
    win_share_autonomous: float


class Trainer:
    def __init__(self, scenario: LearnerScenario, git_revision: str = "unknown") -> None:
        self.scenario = scenario
        self.method = Method(scenario)
        self.git_revision = git_revision
        self.position = Position()
        self.normalizer: Normalizer | None = None
        self.buffer = ReplayBuffer(scenario.method.learner.replay.capacity, self.method.row_sets)
        self.buffer.allocate(
            len(scenario.observation),
            scenario.method.horizon,
            len(scenario.task.action_axes),
            scenario.image_size,
            self.method.bootstraps,
        )
        self.n_demonstrations = 0  # ingested, successful
        self.training_steps = 0  # ingested, learnable
        self._demonstrations: list[Floats] = []  # observations, until the normaliser is fitted
        self._key = jax.random.PRNGKey(scenario.run.seed)
        self.state: LearnerState = self.method.init(scenario.run.seed)
        self._update = make_update(self.method)
        self._compiled_for = 0  # rows allocated
        self._decide = jax.jit(self.method.decide)
        self._see = jax.jit(self.method.see)
        if scenario.run.demonstrations == 0:
            self.normalizer = Normalizer.identity(len(scenario.observation))

    @property
    def updates(self) -> int:
        return int(self.state.updates)

    # ---- episodes

    def ingest(self, episode: Episode) -> None:
        """Puts an episode into the buffer; discarded and faulted ones leave no trace."""
        expected = len(self.scenario.observation)
        if not episode.is_learnable:
            return
        if episode.observation.shape[1] != expected:
            raise ValueError(
                f"Episode {episode.number} has observations of {episode.observation.shape[1]} numbers; "
                f"task.observation of the scenario names {expected} (run.observe {self.scenario.run.observe})."
            )
        if episode.is_training and self.n_demonstrations < self.scenario.run.demonstrations:
            raise ValueError(
                f"Episode {episode.number} is a training episode, but only {self.n_demonstrations} of "
                f"{self.scenario.run.demonstrations} demonstrations came before it; the log is incomplete."
            )
        windows = self.method.windows(episode)
        self.buffer.add(windows, self.method.rows(episode, windows))
        if episode.is_training:
            self.training_steps += episode.n_steps
            return
        self.n_demonstrations += 1
        self._demonstrations.append(episode.observation)
        if self.normalizer is None and self.n_demonstrations == self.scenario.run.demonstrations:
            floor = self.scenario.method.learner.normalizer_floor
            self.normalizer = Normalizer.fit(self._demonstrations, floor)

    def is_last_demonstration(self, episode: Episode) -> bool:
        """After ingest(episode): the warm start is due."""
        return (
            episode.is_demonstration
            and episode.is_learnable
            and self.n_demonstrations == self.scenario.run.demonstrations
        )

    def policy_is_due(self, episode: Episode) -> bool:
        """After ingest(episode): a policy follows it. Discarded training episodes count too."""
        return episode.is_training or self.is_last_demonstration(episode)

    def updates_due(self, episode: Episode) -> int:
        """After ingest(episode): gradient updates that it pays for."""
        learner = self.scenario.method.learner
        if not self._has_data():
            return 0
        if self.is_last_demonstration(episode):
            return learner.warm_start_updates
        if not (episode.is_training and episode.is_learnable):
            return 0
        before = self.training_steps - episode.n_steps
        ratio = self.scenario.updates_per_env_step
        return int(ratio * self.training_steps) - int(ratio * before)

    def _has_data(self) -> bool:
        """Minibatches can be drawn. Before the first training episode they are all prior data."""
        needed = [name for name in self.method.row_sets if name != "online"]
        return all(self.buffer.count(name) > 0 for name in needed)

    def train(self, episode: Episode, after_block: Callable[[Report], bool]) -> bool:
        """Does the updates that are due and moves the position past the episode.

        after_block(report) is called after each block; when it returns False training stops there, the position says
        how far it came, and False is returned.
        """
        due = self.updates_due(episode)
        warm_start = self.is_last_demonstration(episode)
        while self.position.updates_into_next < due:
            start = self.position.updates_into_next
            stop = min(start + BLOCK, due)
            report = self._run(episode.number, start, stop, warm_start)
            self.position.updates_into_next = stop
            if not after_block(report) and stop < due:
                return False
        self.position.episodes_trained_through = episode.number
        self.position.updates_into_next = 0
        self.position.env_steps = max(self.position.env_steps, episode.end.env_steps_total)
        if self.policy_is_due(episode):
            self.position.version += 1
        return True

    def compile(self) -> None:
        """Compiles the update for the present buffer: a call of zero updates."""
        if self._compiled_for != self.buffer.allocated:
            self._run(0, 0, 0, False)

    def _run(self, episode: int, start: int, stop: int, warm_start: bool) -> Report:
        if self._compiled_for != self.buffer.allocated and stop > 0:
            self.compile()
        normalizer = self.normalizer or Normalizer.identity(len(self.scenario.observation))
        began = time.perf_counter()
        self.state, device_sums = self._update(
            self.state,
            self.buffer.arrays,
            self.buffer.rows,
            jnp.asarray(normalizer.mean),
            jnp.asarray(normalizer.scale),
            jax.random.fold_in(self._key, episode),
            jnp.int32(start),
            jnp.int32(stop),
            jnp.bool_(warm_start),
        )
        sums = {name: float(value) for name, value in device_sums.items()}
        self._compiled_for = self.buffer.allocated

        def mean(name: str, of: float) -> float:
            return sums[name] / of if of > 0 else float("nan")

        def share(wins: float, of: float) -> float:
            # in the warm start nothing is compared
            return wins / of if of > 0 and self.method.compares and not warm_start else float("nan")

        n = stop - start
        return Report(
            n_updates=n,
            seconds=time.perf_counter() - began,
            critic_loss=mean("critic_loss", n),
            actor_loss=mean("actor_loss", sums["actor_updates"]),
            win_share=share(sums["human_wins"] + sums["autonomous_wins"], sums["human"] + sums["autonomous"]),
            win_share_human=share(sums["human_wins"], sums["human"]),
            win_share_autonomous=share(sums["autonomous_wins"], sums["autonomous"]),
        )

    def relearn(self, updates: int) -> None:
        """So many updates on what the buffer holds, as if an episode had paid for them; for questions about a run."""
        for start in range(0, updates, BLOCK):
            self._run(0, start, min(start + BLOCK, updates), False)

    def score(self, observation: Floats, chunk: Floats, image: Pixels | None = None) -> Floats:
        """The ensemble's mean (B,) of chunks (B, h, A) at raw observations (B, O) and images; the slow critic's."""
        return self.member_scores(observation, chunk, image).mean(axis=0)

    def member_scores(self, observation: Floats, chunk: Floats, image: Pixels | None = None) -> Floats:
        """The same of each member (M, B)."""
        x = self._seen(observation, image)
        return np.asarray(self.method.values(self.state.average["critic"], x, jnp.asarray(chunk)))

    def sample(self, observation: Floats, image: Pixels | None = None) -> Floats:
        """One chunk (B, h, A) of the actor alone at each raw observation (B, O) and image."""
        x = self._seen(observation, image)
        return np.asarray(self.method.actor.sample(self.state.average["actor"], x, self._key))

    def _seen(self, observation: Floats, image: Pixels | None) -> jax.Array:
        """Raw observations (B, O), images (B, H, W, 3) -> what the deployed actor and critics see."""
        assert self.normalizer is not None, "there is neither policy nor critic before the warm start"
        assert (image is not None) == (self.method.sight is not None), "images belong to an encoder"
        x = jnp.asarray(self.normalizer.apply(observation))
        return self._see(self.state.average, x, None if image is None else jnp.asarray(image))

    # ---- files

    def act(self, observation: Floats, noise: Floats | None = None, image: Pixels | None = None) -> Floats:
        """Raw observations (B, O), images -> chunks (B, h, A) of the deployed policy; noise (B, noise_size) or 0."""
        noise = np.zeros((len(observation), self.method.noise_size), np.float32) if noise is None else noise
        return np.asarray(self._decide(self.state.average, self._seen(observation, image), noise))

    def write_policy(self, path: Path) -> WrittenFile:
        """Writes the deployed policy (the averages) with golden examples."""
        assert self.normalizer is not None, "there is no policy before the warm start"
        config, task = self.scenario.method, self.scenario.task
        architecture, network = self.method.deployed
        header = PolicyHeader(
            architecture=architecture,
            config=network.model_dump(mode="json"),
            observation=self.scenario.observation,
            action=list(task.action_axes),
            task=task.name,
            method=config.name,
            execution=config.execution.model_dump(),
            discount=config.discount,
            version=self.position.version,
            env_steps=self.position.env_steps,
            updates=self.updates,
            episodes_trained_through=self.position.episodes_trained_through,
            git_revision=self.git_revision,
        )
        params = jax.tree.map(np.asarray, self.method.policy(self.state.average))
        mean, scale = self.normalizer.mean, self.normalizer.scale
        generator = np.random.default_rng(self.position.version)
        observation = self._golden_observations(generator)
        golden = golden_examples(
            architecture, network, params, len(task.action_axes), mean, scale, generator, observation
        )
        return write_policy(path, header, params, mean, scale, golden)

    def _golden_observations(self, generator: np.random.Generator) -> Floats:
        """(N, O) raw: some that were really seen, and random ones.

        All within RANGE standard deviations: a golden example tells whether two programs agree about network,
        normaliser and order of names, to 1e-5; a force spike of 60 deviations tells only how float32 rounds.
        """
        assert self.normalizer is not None
        mean, scale = self.normalizer.mean, self.normalizer.scale
        random = generator.normal(size=(GOLDEN_RANDOM, len(mean)))
        seen = (self.buffer.sample_observations(GOLDEN_REAL) - mean) * scale
        golden = np.clip(np.concatenate([seen, random]), -RANGE, RANGE)
        return (mean + golden / scale).astype(np.float32)

    def buffer_digest(self) -> dict[str, object]:
        """What the buffer holds, in a form that two trainings are compared by."""
        return {
            "episodes_trained_through": self.position.episodes_trained_through,
            "steps": self.buffer.size,
            "sha256": self.buffer.sha256(),
        }

    def save(self, path: Path) -> None:
        checkpoint.save(path, self.state, self.normalizer, self.position, self.scenario.fingerprint())

    def restore(self, path: Path) -> None:
        """Takes up a checkpoint; the episodes up to its position still have to be ingested."""
        self.state, self.normalizer, self.position = checkpoint.load(
            path, self.state, self.scenario.fingerprint()
        )
