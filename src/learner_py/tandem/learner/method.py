"""A method as functions: its configuration (head, critic, improvement, decision) turned into what training needs.

Every choice is decided here and nowhere else; what the choices do is in actor.py, critic.py, improvement/ and
networks/best_of_n.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax

from tandem.learner.actor import Actor, make_actor
from tandem.learner.buffer import Arrays
from tandem.learner.config import LearnerScenario, MethodConfig
from tandem.learner.critic import bootstrap_value, expectile_loss, grasp_loss, regression_loss, state_value
from tandem.learner.episode import ACTION_AXES, Bools, Episode, Floats
from tandem.learner.improvement import LOSSES, imitate, sac
from tandem.learner.networks import (
    HEADS,
    Array,
    HeadConfig,
    Mlp,
    Params,
    best_of_n,
    encoded,
    ensemble_values,
    grasp,
    init_ensemble,
    init_mlp,
)
from tandem.learner.networks.mlp import OUTPUT_GAIN, forward
from tandem.learner.windows import Windows, make_windows

Networks = dict[str, Params]  # by role: actor, critic, value, grasp, edit, temperature, encoder, rest

HALF_OPEN_M = 0.04  # of the hand's 80 mm
REST_SCALE = np.array([0.05] * 3 + [0.4] * 3, np.float32)  # m, rad: what is left of the way is told in these
AVERAGED = ("actor", "edit", "critic", "grasp", "encoder")


class LearnerState(NamedTuple):
    """All that gradient updates change. A checkpoint holds every leaf of it."""

    critics: Networks  # critic (leading axis M), value and grasp, where the method has them
    actors: Networks
    average: Networks  # slow copies: what is deployed, evaluated and bootstrapped from; and the reference
    critic_optimizer: optax.OptState
    actor_optimizer: optax.OptState
    updates: Array  # int32, gradient updates so far
    encoder: Networks  # what actor and critics look through, and `rest` behind it; empty when they don't
    encoder_optimizer: optax.OptState


class Batch(NamedTuple):
    x: Array  # (B, O) normalised observations
    chunk: Array  # (B, h, A) executed; without the gripper where a critic of its own decides it
    valid: Array  # (B, h)
    human: Array  # (B, h)
    mc_return: Array  # (B,)
    next_x: Array  # (B, O)
    n_step_return: Array  # (B,)
    bootstrap: Array  # (B,)
    image: Array | None = None  # (B, H, W, 3) uint8
    rest: Array | None = None  # (B, 6) m, rad: how far the tool still went; NaN where nobody knows
    next_image: Array | None = None  # (B, H, W, 3) uint8
    closed: Array | None = None  # (B,) the hand was told to be closed; where a critic of its own decides that
    toggled: Array | None = None  # (B,) it had been told otherwise before


@dataclass(frozen=True)
class Method:
    scenario: LearnerScenario

    @property
    def config(self) -> MethodConfig:
        return self.scenario.method

    @property
    def has_critic(self) -> bool:
        return self.config.learner.critic.kind != "none"

    @property
    def compares(self) -> bool:
        """The actor's loss asks whether the policy's chunk or the logged one scores higher."""
        return self.config.learner.improvement.kind not in ("imitate", "awr")

    @property
    def grasps(self) -> bool:
        """A critic of its own decides the gripper."""
        return self.config.learner.gripper.kind == "critic" and "gripper" in self.scenario.task.action_axes

    @property
    def n_axes(self) -> int:
        """Of the policy."""
        return len(self.scenario.task.action_axes)

    @property
    def n_head_axes(self) -> int:
        """A, of head and critics: all, or all but the gripper."""
        return self.n_axes - self.grasps

    @cached_property
    def sight(self) -> encoded.Sight | None:
        """The image encoder; None when the policy does not look through the camera."""
        if not self.scenario.sees:
            return None
        camera, settings = self.scenario.controller.camera, self.config.learner.image
        first, *rest = settings.channels
        layers = [{"channels": first, "kernel": 5, "stride": 4}]
        layers += [{"channels": n, "kernel": 3, "stride": 2} for n in rest]
        height, width = camera.size
        eye = {"name": camera.name, "height": height, "width": width}
        return encoded.Sight.model_validate(
            {"cameras": [eye], "backbone": {"kind": "cnn", "layers": layers}, "features": settings.features}
        )

    @property
    def bootstraps(self) -> bool:
        """The critic asks for the value of what comes after a window."""
        return self.config.learner.critic.kind in ("td", "iql")

    @cached_property
    def actor(self) -> Actor:
        observation = list(self.scenario.observation)
        if self.sight is not None:
            observation += [f"image_{i}" for i in range(self.sight.features)]
        return make_actor(self.config.learner.head, self.config.horizon, observation, self.n_head_axes)

    @property
    def target_entropy(self) -> float:
        """Of soft actor-critic, for a whole chunk."""
        per_axis = self.config.learner.improvement.sac.target_entropy_per_axis
        return per_axis * self.config.horizon * self.n_head_axes

    def init(self, seed: int) -> LearnerState:
        learner = self.config.learner
        generator = np.random.default_rng(seed)
        n_obs, n_chunk = self.actor.n_observation, self.config.horizon * self.n_head_axes
        actors: Networks = {"actor": self.actor.init(generator)}
        critics: Networks = {}
        if self.has_critic:
            sizes = [n_obs + n_chunk, *learner.critic.hidden, 1]
            critics["critic"] = init_ensemble(generator, learner.critic.members, sizes)
        if learner.improvement.kind == "awr" or learner.critic.kind == "iql":
            critics["value"] = init_ensemble(generator, 1, [n_obs, *learner.critic.hidden, 1])
        if self.grasps:
            critics["grasp"] = grasp.init_critic(generator, self._grasp_critic, n_obs)
        if learner.improvement.kind in ("sac", "e2hil", "expo"):
            actors["temperature"] = sac.init_temperature(learner.improvement.sac.initial_temperature)
        if learner.improvement.kind == "expo":
            edit = learner.improvement.edit
            layers = init_mlp(
                generator, [n_obs + n_chunk, *edit.hidden, 2 * n_chunk], edit.layer_norm, OUTPUT_GAIN
            )
            actors["edit"] = {"layers": layers}
        encoder: Networks = {}
        if self.sight is not None:
            encoder["encoder"] = encoded.init_encoder(generator, self.sight)
            encoder["rest"] = init_mlp(generator, [self.sight.features, 6], False, OUTPUT_GAIN)
        networks = actors | critics | encoder
        average = {name: net for name, net in networks.items() if name in AVERAGED}
        if learner.decision.with_reference:
            average["reference"] = actors["actor"]
        return LearnerState(
            critics=critics,
            actors=actors,
            average=jax.tree.map(jnp.copy, average),
            critic_optimizer=self.critic_optimizer.init(critics),
            actor_optimizer=self.actor_optimizer.init(actors),
            updates=jnp.int32(0),
            encoder=encoder,
            encoder_optimizer=self.actor_optimizer.init(encoder) if encoder else (),
        )

    @property
    def actor_optimizer(self) -> optax.GradientTransformation:
        return optax.adam(self.config.learner.learning_rate)

    @property
    def critic_optimizer(self) -> optax.GradientTransformation:
        learner = self.config.learner
        return optax.adamw(learner.learning_rate, weight_decay=learner.critic.weight_decay)

    # ---- data

    def windows(self, episode: Episode) -> Windows:
        critic = self.config.learner.critic
        return make_windows(
            episode,
            self.scenario.action_columns,
            self.config.horizon,
            self.config.discount,
            cut_return_at_intervention=self.has_critic and critic.cut_return_at_intervention,
            force_free_N=critic.force_free_N,
            force_cost_per_N=critic.force_cost_per_N if self.has_critic else 0.0,
            force_discount=critic.force_discount,
            repeat_at_the_end=critic.end_of_chunk == "repeat",
            bootstrap_steps=critic.td.steps,
            timeout_is_terminal=critic.td.timeout_is_terminal,
            image_size=self.scenario.image_size,
            next_images=self.bootstraps,
            **(self._tool_motion(episode) if self.sight is not None else {}),
        )

    def _tool_motion(self, episode: Episode) -> dict[str, Floats]:
        """What rest_of_the_way asks for beside the actions; a lead that the task's observation lacks counts as none."""
        names, task = self.scenario.observation, self.scenario.task
        observed = np.concatenate([episode.observation, episode.next_observation[-1:]])
        lead = np.zeros((episode.n_steps + 1, 6), np.float32)
        for column, axis in enumerate(ACTION_AXES[:6]):
            if f"lead_{axis}" in names:
                lead[:, column] = observed[:, names.index(f"lead_{axis}")]
        limit = np.repeat([task.translation_limit_m, task.rotation_limit_rad], 3).astype(np.float32)
        return {"lead": lead, "action_limit": limit}

    @property
    def draws(self) -> dict[str, float]:
        """Sets of rows that a minibatch is drawn from, and their shares of it."""
        prior = self.config.learner.replay.prior_share
        if not self.has_critic:
            return {"imitated": 1.0}
        return {"prior": prior, "online": 1.0 - prior} if prior > 0 else {"all": 1.0}

    @property
    def imitates_other_rows(self) -> bool:
        """The actor's minibatch is not the critic's."""
        return self.has_critic and self.config.learner.improvement.data != "all"

    @property
    def row_sets(self) -> list[str]:
        """Names of the sets that the buffer has to keep."""
        return [*self.draws, *(["imitated"] if self.imitates_other_rows else [])]

    def rows(self, episode: Episode, windows: Windows) -> dict[str, Bools]:
        """Which rows (T,) of an episode belong to each set."""
        everything = np.ones(episode.n_steps, bool)
        human = windows.human[:, 0]
        imitated = {
            "all": everything,
            "human": human,
            "demonstrations": everything & episode.is_demonstration,
            "success": windows.mc_return > self.config.learner.improvement.least_return,
        }[self.config.learner.improvement.data]
        # demonstrations and interventions; training episodes, interventions included (as HIL-SERL's two buffers)
        online = everything & (not episode.is_demonstration)
        return {"all": everything, "prior": human, "online": online, "imitated": imitated}

    def batch(self, arrays: Arrays, rows: Array, mean: Array, scale: Array, key: Array) -> Batch:
        """Gathers buffer rows (B,). key: of the images' shifts."""
        shift = self.config.learner.image.shift_px
        images = {
            name: shifted(arrays[name][rows], jax.random.fold_in(key, i), shift)
            for i, name in enumerate(("image", "next_image"))
            if name in arrays
        }
        names = ("chunk", "valid", "human", "mc_return", "n_step_return", "bootstrap")
        batch = Batch(
            x=(arrays["observation"][rows] - mean) * scale,
            next_x=(arrays["next_observation"][rows] - mean) * scale,
            **{name: arrays[name][rows] for name in names},
            **images,
            rest=arrays["rest"][rows] if images else None,
        )
        if not self.grasps:
            return batch
        commanded = arrays["observation"][rows, self.scenario.observation.index("gripper_commanded")]
        closed = batch.chunk[:, 0, -1] > 0.0
        toggled = closed != (commanded < HALF_OPEN_M)
        return batch._replace(chunk=batch.chunk[..., :-1], closed=closed, toggled=toggled)

    def see(self, encoder: Networks, x: Array, image: Array | None) -> Array:
        """Normalised observations (B, O), images (B, H, W, 3) -> what actor and critics see, (B, O + F)."""
        if self.sight is None:
            return x
        assert image is not None, "an encoder needs images"
        return encoded.encode(encoder["encoder"], self.sight, x, {self.sight.cameras[0].name: image})

    def seen(self, encoder: Networks, batch: Batch) -> Batch:
        """The batch with its x as actor and critics see it."""
        return batch._replace(x=self.see(encoder, batch.x, batch.image))

    # ---- the policy

    @cached_property
    def deployed(self) -> tuple[str, HeadConfig]:
        """Architecture and config of the policy file."""
        architecture, config = self.behind_encoder
        if self.sight is None:
            return architecture, config
        head = {"architecture": architecture, "config": config.model_dump()}
        return "encoded", encoded.Config.model_validate({**self.sight.model_dump(), "head": head})

    @cached_property
    def behind_encoder(self) -> tuple[str, HeadConfig]:
        """Architecture and config of the policy but its encoder."""
        architecture, config = self.decision
        if not self.grasps:
            return architecture, config
        arm = {"architecture": architecture, "config": config.model_dump()}
        return "grasp", grasp.Config.model_validate({"head": arm, "critic": self._grasp_critic.model_dump()})

    @cached_property
    def decision(self) -> tuple[str, HeadConfig]:
        """Architecture and config of what decides the head's axes."""
        learner, actor = self.config.learner, self.actor
        if learner.decision.kind == "head":
            return actor.architecture, actor.config
        n_heads = 2 if learner.decision.with_reference else 1
        proposer = {
            "architecture": actor.architecture,
            "config": actor.config.model_dump(),
            "samples": learner.decision.samples,
        }
        config: dict[str, Any] = {
            "horizon": self.config.horizon,
            "heads": [proposer] * n_heads,
            "edit": learner.improvement.edit.model_dump() if learner.improvement.kind == "expo" else None,
            "critic": {
                "hidden": learner.critic.hidden,
                "activation": learner.critic.activation,
                "layer_norm": True,
                "members": learner.critic.members,
                "aggregate": learner.decision.aggregate,
            },
        }
        return "best_of_n", best_of_n.Config.model_validate(config)

    @property
    def _grasp_critic(self) -> grasp.Critic:
        hidden, activation = self.config.learner.gripper.hidden, self.config.learner.critic.activation
        return grasp.Critic(hidden=tuple(hidden), activation=activation, layer_norm=True)

    def policy(self, networks: Networks) -> Params:
        """The parameters of the deployed policy, of the learner's networks."""
        _, config = self.deployed
        if isinstance(config, encoded.Config):
            return encoded.together(networks["encoder"], config, self._behind_encoder(networks))
        return self._behind_encoder(networks)

    def _behind_encoder(self, networks: Networks) -> Params:
        deciding = self._deciding(networks)
        return {"actor": deciding, "grasp": networks["grasp"]} if self.grasps else deciding

    def _deciding(self, networks: Networks) -> Params:
        if self.config.learner.decision.kind == "head":
            return networks["actor"]
        heads = [networks["actor"]]
        if self.config.learner.decision.with_reference:
            heads.append(networks["reference"])
        members = range(self.config.learner.critic.members)
        critics = [
            {"layers": jax.tree.map(lambda array, m=member: array[m], networks["critic"])}
            for member in members
        ]
        edit = {"edit": networks["edit"]} if "edit" in networks else {}
        return {"actor": heads, "critic": critics, **edit}

    def decide(self, networks: Networks, x: Array, noise: Array) -> Array:
        """What is seen behind the encoder (B, O or O + F), noise -> the chunks (B, h, A) that the arm executes."""
        architecture, config = self.behind_encoder
        return HEADS[architecture].chunk(self._behind_encoder(networks), config, x, noise, {})

    @property
    def noise_size(self) -> int:
        architecture, config = self.deployed
        return HEADS[architecture].noise_size(config, self.n_axes)

    # ---- losses

    def values(self, critic: Mlp, x: Array, chunk: Array) -> Array:
        """Q (M, B). chunk: the head's axes, or all of the policy's."""
        return ensemble_values(
            critic, x, chunk[..., : self.n_head_axes], self.config.learner.critic.activation
        )

    def state_value(self, value: Mlp, x: Array) -> Array:
        """V (B,)."""
        return state_value(value, x, self.config.learner.critic.activation)

    def critic_loss(
        self, trained: Networks, encoder: Networks, state: LearnerState, batch: Batch, key: Array
    ) -> tuple[Array, Array]:
        """Loss, and ranking score (B,) of the batch's chunks."""
        settings = self.config.learner.critic
        batch = self.seen(encoder, batch)
        values = self.values(trained["critic"], batch.x, batch.chunk)
        target = batch.mc_return
        if settings.kind != "mc":
            target = batch.n_step_return + batch.bootstrap * self._next_value(state, batch, key)
        loss = regression_loss(values, lax.stop_gradient(target))
        if "value" in trained:
            value = self.state_value(trained["value"], batch.x)
            if settings.kind == "mc":
                loss += regression_loss(value[None], batch.mc_return)
            else:
                slow = self.values(state.average["critic"], batch.x, batch.chunk)
                below = slow.min(axis=0) if settings.td.aggregate == "min" else slow.mean(axis=0)
                loss += expectile_loss(value, below, settings.expectile)
        if "grasp" in trained:
            loss += self._grasp_loss(trained["grasp"], state, batch)
        return loss, lax.stop_gradient(values.mean(axis=0))

    def _grasp_loss(self, trained: Params, state: LearnerState, batch: Batch) -> Array:
        assert batch.closed is not None and batch.toggled is not None, (
            "the method has a critic of the gripper"
        )
        activation = self.config.learner.critic.activation
        next_x = self.see(state.encoder, batch.next_x, batch.next_image)
        live, slow = state.critics["grasp"]["layers"], state.average["grasp"]["layers"]
        return grasp_loss(
            grasp.worth(trained["layers"], activation, batch.x),
            batch.closed,
            batch.n_step_return - self.config.learner.gripper.toggle_cost * batch.toggled,
            batch.bootstrap,
            grasp.worth(live, activation, next_x),
            grasp.worth(slow, activation, next_x),
        )

    def _next_value(self, state: LearnerState, batch: Batch, key: Array) -> Array:
        """Value (B,) of the state that a window leads to."""
        settings = self.config.learner.critic
        next_x = self.see(state.encoder, batch.next_x, batch.next_image)
        if settings.kind == "iql":
            return self.state_value(state.critics["value"], next_x)
        key_noise, key_subset = jax.random.split(key)
        # the policy as it is now, its choice and its value by the slow critic
        live: Networks = {name: net for name, net in state.actors.items() if name in state.average}
        networks = {**state.average, **live}
        noise = jax.random.normal(key_noise, (len(next_x), self.noise_size))
        chunk = self.decide(networks, next_x, noise)
        values = self.values(state.average["critic"], next_x, chunk)
        return bootstrap_value(values, settings.td.subset, settings.td.aggregate, key_subset)

    def actor_loss(
        self,
        trained: Networks,
        encoder: Networks,
        state: LearnerState,
        batch: Batch,
        q_buffer: Array,
        key: Array,
        warm_start: Array,
    ) -> tuple[Array, Array]:
        """Loss and policy_wins (B,). warm_start: imitate the batch, the critic is too young to rank."""
        kind = self.config.learner.improvement.kind
        batch = self.seen(encoder, batch)  # once: two would be two ways back through the encoder
        beside = self._rest_loss(encoder, batch) if self.sight is not None else 0.0
        if not self.config.learner.image.actor_teaches:
            batch = batch._replace(x=lax.stop_gradient(batch.x))
        arguments = (self, trained, state.critics, batch, q_buffer, key)
        if kind == "imitate":
            loss, wins = imitate.loss(*arguments)
        else:
            loss, wins = lax.cond(
                warm_start, lambda: imitate.loss(*arguments), lambda: LOSSES[kind](*arguments)
            )
        return loss + beside, wins

    def _rest_loss(self, encoder: Networks, seen: Batch) -> Array:
        """How wrong a linear map of the image's features tells the rest of the way. It teaches where things are.

        Of these alone: velocity and force tell it as well where a human moves the arm, and nowhere else.
        """
        assert self.sight is not None and seen.rest is not None, "the method has an encoder"
        features = seen.x[:, -self.sight.features :]
        told = forward(encoder["rest"], features.T, "relu").T
        known = jnp.isfinite(seen.rest)
        error = jnp.where(known, told - jnp.where(known, seen.rest, 0.0) / REST_SCALE, 0.0)
        return self.config.learner.image.rest_weight * jnp.abs(error).mean()

    def averages(self, state: LearnerState, networks: Networks, warm_start: Array) -> Networks:
        """The slow copies after an update that made `networks`."""
        learner = self.config.learner
        critic_decay = learner.critic.td.target_decay if self.bootstraps else learner.ema
        average: Networks = {}
        for name, old in state.average.items():
            if name == "reference":
                continue
            # a young average follows quickly, so that it forgets the random start
            decay = jnp.minimum(
                critic_decay if name in ("critic", "grasp") else learner.ema,
                (1.0 + state.updates) / (10.0 + state.updates),
            )
            average[name] = _mix(decay, old, networks[name])
        if "reference" in state.average:
            # the actor at the end of the warm start, and no further
            average["reference"] = _mix(
                jnp.where(warm_start, 0.0, 1.0), state.average["reference"], average["actor"]
            )
        return average


def shifted(image: Array, key: Array, most: int) -> Array:
    """Each image (B, H, W, C) moved by up to `most` pixels up or down and left or right, edges repeated (DrQ)."""
    if most == 0:
        return image
    height, width = image.shape[1:3]
    offset = jax.random.randint(key, (2, len(image)), -most, most + 1)
    rows = jnp.clip(jnp.arange(height) + offset[0][:, None], 0, height - 1)  # (B, H)
    columns = jnp.clip(jnp.arange(width) + offset[1][:, None], 0, width - 1)  # (B, W)
    image = jnp.take_along_axis(image, rows[:, :, None, None], axis=1)
    return jnp.take_along_axis(image, columns[:, None, :, None], axis=2)


def _mix(decay: Array, old: Params, new: Params) -> Params:
    return jax.tree.map(lambda a, b: decay * a + (1.0 - decay) * b, old, new)
