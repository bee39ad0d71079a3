"""What the learner reads from a scenario: typed, ranged, unknown keys refused. No JAX here, so that checks are quick.

A method is four independent choices (head, critic, improvement, decision) and the settings they share; `method.py`
turns this description into functions. Defaults are deliberately absent: a scenario says everything.
"""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import annotated_types
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tandem import scenario as scenario_file
from tandem.learner.episode import ACTION_AXES
from tandem.scenario import ScenarioError

MAX_SAMPLES = 256  # that the policy runtime takes from all heads together
WIDTH_LIMITS = annotated_types.Interval(ge=1, le=4096)
Width = Annotated[int, WIDTH_LIMITS]


class Strict(BaseModel):
    """A section that the learner owns: every key known, in its type and range."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Lenient(BaseModel):
    """A section that others read too: only our keys are looked at."""

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True, allow_inf_nan=False)


class Execution(Strict):
    """How the controller executes chunks; copied into the policy file."""

    mode: Literal["receding", "open_loop", "temporal_ensembling"]
    execute: int = Field(ge=1, le=64)
    ensemble_decay: float = Field(ge=-10, le=10)
    latency_ticks: int = Field(ge=0, lt=1000)  # the controller checks it against the policy step
    noise_chunk: float = Field(ge=0, le=1)
    noise_step: float = Field(ge=0, le=1)
    noise_clip: float = Field(ge=0, le=2)
    noise_speed: float = Field(ge=0, le=4)


Widths = Annotated[list[Width], Field(min_length=1, max_length=8)]
Activation = Literal["relu", "tanh", "gelu"]
LogStd = Annotated[float, Field(ge=-20, le=5)]


class MlpHead(Strict):
    hidden: Widths
    activation: Activation
    layer_norm: bool


class GaussianHead(MlpHead):
    log_std_min: LogStd
    log_std_max: LogStd


class FlowHead(MlpHead):
    steps: int = Field(ge=1, le=100)
    time_features: int = Field(ge=2, le=256, multiple_of=2)


class ActHead(Strict):
    model_size: int = Field(ge=1, le=4096)
    heads: int = Field(ge=1, le=64)
    feedforward: int = Field(ge=1, le=16384)
    encoder_layers: int = Field(ge=1, le=16)
    decoder_layers: int = Field(ge=1, le=16)
    activation: Literal["relu", "gelu"]
    latent_size: int = Field(ge=1, le=1024)
    sample_latent: bool


class Head(Strict):
    """The actor's network, observation -> chunk; `kind` says which of the sections counts."""

    kind: Literal["mlp", "gaussian", "flow", "act"]
    mlp: MlpHead
    gaussian: GaussianHead
    flow: FlowHead
    act: ActHead


class TdCritic(Strict):
    steps: int = Field(ge=1, le=256)
    target_decay: float = Field(ge=0, lt=1)
    subset: int = Field(ge=0, le=32)
    aggregate: Literal["mean", "min"]
    timeout_is_terminal: bool


class Critic(Strict):
    """What scores a chunk, and the return that it learns."""

    kind: Literal["mc", "td", "iql", "none"]
    members: int = Field(ge=1, le=32)
    hidden: Widths
    activation: Activation
    weight_decay: float = Field(ge=0, le=100)
    end_of_chunk: Literal["hold", "repeat"]
    cut_return_at_intervention: bool
    force_free_N: float = Field(ge=0, le=1000)
    force_cost_per_N: float = Field(ge=0, le=1)
    force_discount: float | None = Field(gt=0, le=1)
    td: TdCritic
    expectile: float = Field(gt=0, lt=1)


class MaxQ(Strict):
    imitate_self: bool
    buffer_score: Literal["critic", "return"]
    pessimism: float = Field(ge=0, le=10)


class Awr(Strict):
    inverse_temperature: float = Field(gt=0, le=100)
    weight_limit: float = Field(ge=1, le=1e6)


class Sac(Strict):
    initial_temperature: float = Field(gt=0, le=10)
    target_entropy_per_axis: float = Field(ge=-10, le=10)


class E2hil(Strict):
    samples: int = Field(ge=2, le=64)
    low_quantile: float = Field(ge=0, le=1)
    high_quantile: float = Field(ge=0, le=1)


class Edit(GaussianHead):
    scale: float = Field(gt=0, le=1)


class Improvement(Strict):
    """How the actor improves; `kind` says which of the sections counts."""

    kind: Literal["max_q", "imitate", "awr", "q_gradient", "sac", "e2hil", "expo"]
    data: Literal["all", "human", "demonstrations", "success"]
    least_return: float = Field(ge=-1, lt=1)
    max_q: MaxQ
    awr: Awr
    sac: Sac
    e2hil: E2hil
    edit: Edit


class Decision(Strict):
    """How an action comes out of the head."""

    kind: Literal["head", "best_of_n"]
    samples: int = Field(ge=1, le=MAX_SAMPLES)
    aggregate: Literal["mean", "min"]
    with_reference: bool


class Gripper(Strict):
    """What decides the gripper, on tasks that have one among their axes."""

    kind: Literal["head", "critic"]
    hidden: Widths
    toggle_cost: float = Field(ge=0, le=1)


class Replay(Strict):
    """Which rows minibatches hold."""

    batch: int = Field(ge=1, le=65_536)
    prior_share: float = Field(ge=0, le=1)
    half_life: int = Field(ge=0, le=100_000_000)
    capacity: int = Field(ge=1_000, le=100_000_000)


class ImageEncoder(Strict):
    """With run.observe image: the encoder that actor and critics share, and what images change in the training."""

    channels: Widths
    features: int = Field(ge=1, le=1024)
    shift_px: int = Field(ge=0, le=16)
    actor_teaches: bool
    rest_weight: float = Field(ge=0, le=100)
    batch: int = Field(ge=1, le=65_536)
    updates_per_env_step: float = Field(ge=0, le=100)


class LearnerConfig(Strict):
    head: Head
    critic: Critic
    improvement: Improvement
    decision: Decision
    gripper: Gripper
    replay: Replay
    image: ImageEncoder
    warm_start_updates: int = Field(ge=0, le=1_000_000)
    updates_per_env_step: float = Field(ge=0, le=100)
    updates_per_actor_update: int = Field(ge=1, le=100)
    learning_rate: float = Field(gt=0, le=1)
    ema: float = Field(ge=0, lt=1)
    normalizer_floor: float = Field(gt=0, le=1)
    checkpoint_every_s: float = Field(ge=0, le=3600)


class MethodConfig(Strict):
    """The section `method` of a scenario."""

    name: str
    discount: float = Field(gt=0, le=1)
    horizon: int = Field(ge=1, le=64)
    execution: Execution
    learner: LearnerConfig

    @model_validator(mode="after")
    def _parts_fit(self) -> MethodConfig:
        for says, rule in self._misfits():
            raise ValueError(f"{says}; {rule}")
        return self

    def _misfits(self) -> Iterator[tuple[str, str]]:
        learner = self.learner
        improvement, critic, td = learner.improvement, learner.critic, learner.critic.td
        if self.execution.execute > self.horizon:
            yield (
                f"execution.execute is {self.execution.execute}",
                f"it must be in [1, horizon] = [1, {self.horizon}]",
            )
        if improvement.kind != "imitate" and critic.kind == "none":
            yield (
                f"learner.critic.kind is none; improvement {improvement.kind} asks a critic",
                "choose mc, td or iql",
            )
        if learner.decision.kind == "best_of_n" and critic.kind == "none":
            yield "learner.critic.kind is none; decision best_of_n asks a critic", "choose mc, td or iql"
        if improvement.kind == "max_q" and improvement.data != "all":
            yield f"learner.improvement.data is {improvement.data}", "max_q learns from all data: choose all"
        if improvement.kind in ("sac", "e2hil") and learner.head.kind != "gaussian":
            yield (
                f"learner.head.kind is {learner.head.kind}",
                f"{improvement.kind} needs its log-density: choose gaussian",
            )
        if critic.kind in ("td", "iql") and td.steps < self.horizon:
            yield (
                f"learner.critic.td.steps is {td.steps}",
                f"it must not be less than the horizon of {self.horizon}",
            )
        if td.subset > critic.members:
            yield (
                f"learner.critic.td.subset is {td.subset}",
                f"there are {critic.members} critics (learner.critic.members)",
            )
        if improvement.kind == "expo" and learner.decision.kind != "best_of_n":
            yield (
                f"learner.decision.kind is {learner.decision.kind}",
                "expo decides between samples and their edits: choose best_of_n",
            )
        if learner.decision.with_reference and learner.decision.kind != "best_of_n":
            yield "learner.decision.with_reference is true", "it is for best_of_n"
        if learner.decision.with_reference and 2 * learner.decision.samples > MAX_SAMPLES:
            yield (
                f"learner.decision.samples is {learner.decision.samples}, and with_reference draws as many more",
                f"there may be {MAX_SAMPLES} together",
            )
        if learner.gripper.kind == "critic" and (critic.kind, self.horizon) != ("td", 1):
            yield (
                f"learner.gripper.kind is critic, critic.kind {critic.kind}, horizon {self.horizon}",
                "the gripper's critic learns from one step to the next: td and 1",
            )
        if learner.gripper.kind == "critic" and learner.decision.kind != "head":
            yield (
                f"learner.decision.kind is {learner.decision.kind}",
                "beside a gripper's critic it must be head: best_of_n chooses among whole actions",
            )
        if improvement.e2hil.low_quantile >= improvement.e2hil.high_quantile:
            yield (
                f"learner.improvement.e2hil.low_quantile is {improvement.e2hil.low_quantile}",
                f"it must be less than high_quantile = {improvement.e2hil.high_quantile}",
            )
        for place, network in (
            ("head.gaussian", learner.head.gaussian),
            ("improvement.edit", improvement.edit),
        ):
            if network.log_std_min > network.log_std_max:
                yield (
                    f"learner.{place}.log_std_min is {network.log_std_min}",
                    f"it must not be more than log_std_max = {network.log_std_max}",
                )


class RunConfig(Lenient):
    """What the learner reads of the section `run`."""

    task: str
    seed: int = Field(ge=0)
    demonstrations: int = Field(ge=0)
    env_steps: int = Field(ge=1)
    learner_lag: int = Field(ge=0)
    evaluation_every: int = Field(ge=1)
    observe: Literal["state", "image"]


class TaskConfig(Lenient):
    """What the learner reads of the section `task`."""

    name: str
    max_steps: int = Field(ge=1)
    observation: list[str] = Field(min_length=1)
    translation_limit_m: float = Field(gt=0)  # that an action of 1 moves the commanded pose by
    rotation_limit_rad: float = Field(gt=0)
    action_axes: list[Literal["x", "y", "z", "rx", "ry", "rz", "gripper"]] = Field(min_length=1)

    @model_validator(mode="after")
    def _axes_in_order(self) -> TaskConfig:
        ordered = [axis for axis in ACTION_AXES if axis in self.action_axes]
        if self.action_axes != ordered:
            raise ValueError(
                f"action_axes is {self.action_axes}; it must be in wire order without repeats: {ordered}"
            )
        return self


class CameraConfig(Lenient):
    name: str
    views: list[str] = Field(min_length=1)
    width_px: int = Field(ge=16, le=512)  # of a view
    height_px: int = Field(ge=16, le=512)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the image."""
        return self.height_px, self.width_px * len(self.views)


class ControllerConfig(Lenient):
    """What the learner reads of the section `controller`."""

    camera: CameraConfig


class LearnerScenario(Lenient):
    """The whole of what the learner needs to know."""

    run: RunConfig
    task: TaskConfig
    controller: ControllerConfig
    method: MethodConfig

    @model_validator(mode="after")
    def _gripper_fits(self) -> LearnerScenario:
        has_axis = "gripper" in self.task.action_axes
        needs = self.method.learner.gripper.kind == "critic" and has_axis
        if needs and "gripper_commanded" not in self.observation:
            raise ValueError(
                "method.learner.gripper.kind is critic, and task.observation lacks gripper_commanded, by which it tells"
                " a change of mind"
            )
        return self

    @model_validator(mode="after")
    def _images_fit(self) -> LearnerScenario:
        if self.sees and self.method.learner.decision.with_reference:
            raise ValueError(
                "method.learner.decision.with_reference is true; with run.observe image it must be false: the reference"
                " stands still, and the encoder that it looks through goes on learning"
            )
        return self

    @property
    def observation(self) -> list[str]:
        """Names of the numbers that the policy sees."""
        return scenario_file.observed(self.run.observe, self.task.observation)

    @property
    def sees(self) -> bool:
        """The policy looks through the camera."""
        return self.run.observe == "image"

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Height and width; None when there are no images."""
        return self.controller.camera.size if self.sees else None

    @property
    def batch(self) -> int:
        """Rows in a minibatch."""
        learner = self.method.learner
        return learner.image.batch if self.sees else learner.replay.batch

    @property
    def updates_per_env_step(self) -> float:
        learner = self.method.learner
        return learner.image.updates_per_env_step if self.sees else learner.updates_per_env_step

    @property
    def action_columns(self) -> list[int]:
        """Columns of the active axes in the 7 numbers of an action."""
        return [ACTION_AXES.index(axis) for axis in self.task.action_axes]

    def fingerprint(self) -> str:
        """sha256 over everything that decides the learnt parameters; a checkpoint of another one is not resumed."""
        facts = {
            "seed": self.run.seed,
            "demonstrations": self.run.demonstrations,
            "task": self.task.model_dump(),
            "camera": self.controller.camera.model_dump() if self.sees else None,
            "method": self.method.model_dump(exclude={"learner": {"checkpoint_every_s"}}),
        }
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def load_scenario(path: Path, overrides: Iterable[str] = ()) -> LearnerScenario:
    """Reads RUN/scenario.yaml and applies `a.b=c`. Raises ScenarioError with one sentence: place, value, limit."""
    resolved = scenario_file.load(path)
    for assignment in overrides:
        resolved.override(assignment)
    try:
        return LearnerScenario.model_validate(resolved.data)
    except ValidationError as error:
        raise ScenarioError(_sentence(error, resolved, path)) from None


def check_method(section: dict[str, Any]) -> MethodConfig:
    """The section `method` as a typed object, for programs that only check. Raises pydantic.ValidationError."""
    return MethodConfig.model_validate(section)


def _sentence(error: ValidationError, resolved: scenario_file.Scenario, path: Path) -> str:
    """`FILE:LINE: dotted.key is VALUE; it must be ...` for the first error."""
    first = error.errors()[0]
    location = [str(part) for part in first["loc"]]
    # list items have no line of their own: point to the nearest key above
    key = next(
        (
            ".".join(location[:n])
            for n in range(len(location), 0, -1)
            if ".".join(location[:n]) in resolved.origins
        ),
        "",
    )
    place = str(resolved.origins[key]) if key else str(path)
    dotted = ".".join(location)
    kind, context = first["type"], first.get("ctx", {})
    if kind == "missing":
        return f"{place}: {dotted} is missing."
    if kind == "extra_forbidden":
        section = ".".join(location[:-1])
        known = _keys_of(location[:-1])
        near = difflib.get_close_matches(location[-1], known, n=1, cutoff=0.0)
        hint = f"; the nearest is {section}.{near[0]}" if near else ""
        return f"{place}: there is no key {dotted}{hint}."
    if kind == "value_error":
        return f"{place}: {dotted}: {context['error']}."
    if kind in ("greater_than_equal", "greater_than", "less_than_equal", "less_than"):
        return f"{place}: {dotted} is {first['input']!r}; it must be in {_interval(location)}."
    return f"{place}: {dotted} is {first['input']!r}; {first['msg'][0].lower()}{first['msg'][1:]}."


def _model_at(location: list[str]) -> Any:
    model: Any = LearnerScenario
    for part in location:
        model = model.model_fields[part].annotation
    return model


def _keys_of(location: list[str]) -> list[str]:
    return list(_model_at(location).model_fields)


def _interval(location: list[str]) -> str:
    """`[LO, HI]` from the field's own limits; parentheses where a limit is excluded."""
    names = [part for part in location if not part.isdigit()]
    field = _model_at(names[:-1]).model_fields[names[-1]]
    limits: list[Any] = list(field.metadata)
    if len(names) < len(location):  # an item of a list of widths
        limits = [WIDTH_LIMITS]
    low, high = "(-inf", "inf)"
    for limit in limits:
        for attribute, text in (("ge", "[{}"), ("gt", "({}")):
            if getattr(limit, attribute, None) is not None:
                low = text.format(getattr(limit, attribute))
        for attribute, text in (("le", "{}]"), ("lt", "{})")):
            if getattr(limit, attribute, None) is not None:
                high = text.format(getattr(limit, attribute))
    return f"{low}, {high}"
