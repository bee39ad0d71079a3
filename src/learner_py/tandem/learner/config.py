"""What the learner reads from a scenario: typed, ranged, unknown keys refused. No JAX here, so that checks are quick.

A method is four independent choices (head, critic, improvement, decision) and the settings they share; `method.py`
turns this description into functions. Defaults are deliberately absent: a scenario says everything.
"""

from __future__ import annotations

import difflib
import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

import annotated_types
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tandem import scenario as scenario_file
from tandem.learner.episode import ACTION_AXES
from tandem.scenario import ScenarioError

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
    ensemble_decay: float = Field(ge=0, le=10)
    latency_ticks: int = Field(ge=0, lt=1000)  # the controller checks it against the policy step
    noise_chunk: float = Field(ge=0, le=1)
    noise_step: float = Field(ge=0, le=1)
    noise_clip: float = Field(ge=0, le=2)


class Head(Strict):
    """The actor's network: observation -> chunk."""

    kind: Literal["mlp"]
    hidden: list[Width] = Field(min_length=1, max_length=8)
    activation: Literal["relu", "tanh", "gelu"]
    layer_norm: bool


class Critic(Strict):
    """What scores a chunk, and the return that it learns."""

    kind: Literal["mc", "none"]
    members: int = Field(ge=1, le=32)
    hidden: list[Width] = Field(min_length=1, max_length=8)
    cut_return_at_intervention: bool


class Improvement(Strict):
    """How the actor improves."""

    kind: Literal["max_q", "imitate"]
    data: Literal["all", "human", "demonstrations"]


class Decision(Strict):
    """How an action comes out of the head."""

    kind: Literal["head"]


class LearnerConfig(Strict):
    head: Head
    critic: Critic
    improvement: Improvement
    decision: Decision
    warm_start_updates: int = Field(ge=0, le=1_000_000)
    updates_per_env_step: float = Field(ge=0, le=100)
    batch: int = Field(ge=1, le=65_536)
    learning_rate: float = Field(gt=0, le=1)
    ema: float = Field(ge=0, lt=1)
    buffer_capacity: int = Field(ge=1_000, le=100_000_000)
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
        if self.execution.execute > self.horizon:
            raise ValueError(
                f"execution.execute is {self.execution.execute}; it must be in [1, horizon] = [1, {self.horizon}]"
            )
        improvement, critic = self.learner.improvement, self.learner.critic
        if improvement.kind == "max_q" and critic.kind == "none":
            raise ValueError(
                "learner.critic.kind is none; improvement max_q ranks actions by a critic: choose mc"
            )
        if improvement.kind == "max_q" and improvement.data != "all":
            raise ValueError(
                f"learner.improvement.data is {improvement.data}; max_q learns from all data: choose all"
            )
        if improvement.kind == "imitate" and critic.kind != "none":
            raise ValueError(
                f"learner.critic.kind is {critic.kind}; improvement imitate ranks nothing: choose none"
            )
        return self


class RunConfig(Lenient):
    """What the learner reads of the section `run`."""

    task: str
    seed: int = Field(ge=0)
    demonstrations: int = Field(ge=0)
    env_steps: int = Field(ge=1)
    learner_lag: int = Field(ge=0)
    evaluation_every: int = Field(ge=1)


class TaskConfig(Lenient):
    """What the learner reads of the section `task`."""

    name: str
    max_steps: int = Field(ge=1)
    observation: list[str] = Field(min_length=1)
    action_axes: list[Literal["x", "y", "z", "rx", "ry", "rz", "gripper"]] = Field(min_length=1)

    @model_validator(mode="after")
    def _axes_in_order(self) -> TaskConfig:
        ordered = [axis for axis in ACTION_AXES if axis in self.action_axes]
        if self.action_axes != ordered:
            raise ValueError(
                f"action_axes is {self.action_axes}; it must be in wire order without repeats: {ordered}"
            )
        return self


class LearnerScenario(Lenient):
    """The whole of what the learner needs to know."""

    run: RunConfig
    task: TaskConfig
    method: MethodConfig

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
            "method": self.method.model_dump(exclude={"learner": {"checkpoint_every_s"}}),
        }
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def load_scenario(path: Path) -> LearnerScenario:
    """Reads RUN/scenario.yaml. Raises ScenarioError with one sentence: place, value, limit."""
    resolved = scenario_file.load(path)
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
