"""Ablations: config/ablations/NAME.yaml, a question and the variants that answer it.

title: What scores a chunk
question: Do returns really earned teach the critic better than bootstrapped ones?
task: peg
method: tandem          # of all variants that name none
run: {video_episodes: 0}  # of all variants: keys of the section `run`
variants:
  - label: mc
  - label: td
    set: {method.learner.critic.kind: td}
"""

import difflib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tandem import scenario
from tandem.experiments.runs import Run, Setting
from tandem.run_folder import CONFIG, RUNS, RunFolder
from tandem.scenario import Origin, ScenarioError

FOLDER = RUNS / "ablations"

_KEYS = ("title", "question", "task", "method", "run", "variants")
_VARIANT_KEYS = ("label", "method", "set")


@dataclass(frozen=True)
class Variant:
    label: str
    method: str
    settings: tuple[Setting, ...]


@dataclass(frozen=True)
class Ablation:
    name: str
    title: str
    question: str
    task: str
    settings: tuple[Setting, ...]  # of all variants
    variants: tuple[Variant, ...]

    def only(self, labels: Sequence[str]) -> "Ablation":
        """With these of its variants. @raises ScenarioError when it has no such one."""
        known = [variant.label for variant in self.variants]
        for label in labels:
            if label not in known:
                near = difflib.get_close_matches(label, known, n=1, cutoff=0.0)[0]
                raise ScenarioError(f"{self.name} has no variant {label!r}; the nearest is {near}.")
        return replace(self, variants=tuple(v for v in self.variants if v.label in labels))

    def runs(self, folder: Path, seeds: Sequence[int], further: Sequence[Setting] = ()) -> list[Run]:
        """Variants x seeds, seed by seed, in `folder`/LABEL-seedS. further: settings from the command line.

        @raises ScenarioError when one of `further` would undo what the variants differ in.
        """
        varied = {setting.key: setting for variant in self.variants for setting in variant.settings}
        for setting in further:
            if clash := varied.get(setting.key):
                raise ScenarioError(
                    f"{setting.place}: the variants of {self.name} differ in {setting.key} ({clash.place});"
                    " set another key, or change the variants there."
                )
        return [
            Run(
                variant.label,
                self.task,
                variant.method,
                seed,
                RunFolder(folder / f"{variant.label}-seed{seed}"),
                (*self.settings, *further, *variant.settings),
            )
            for seed in seeds
            for variant in self.variants
        ]


def names(config: Path = CONFIG) -> list[str]:
    return scenario.names(config / "ablations")


def load(name: str, config: Path = CONFIG) -> Ablation:
    """Reads an ablation's file. @raises ScenarioError `file:line: ...` on anything that it should not hold.

    Whether methods, tasks and settings exist is judged with the runs (`tandem.experiments.runs.check`).
    """
    file = scenario.choose(config / "ablations", name, "ablation")
    display = str(Path(config.name) / file.relative_to(config))
    data, origins = scenario.read_yaml(file, display)
    _check_keys(data, _KEYS, "", origins)
    for key in ("title", "question", "task", "method", "variants"):
        if key not in data:
            raise ScenarioError(f"{display}:1: {key} is missing.")
    for key in ("title", "question", "task", "method"):
        _check_text(data[key], key, origins)
    if not isinstance(data["variants"], list) or len(data["variants"]) < 2:
        raise ScenarioError(
            f"{origins['variants']}: variants must be a list of two or more, each with a label."
        )
    variants: dict[str, Variant] = {}
    for number, body in enumerate(data["variants"]):
        variant = _variant(body, f"variants.{number}", data["method"], origins)
        if variant.label in variants:
            place = origins[f"variants.{number}.label"]
            raise ScenarioError(f"{place}: there are two variants {variant.label}; labels must differ.")
        variants[variant.label] = variant
    return Ablation(
        name,
        data["title"],
        data["question"],
        data["task"],
        _settings(data.get("run", {}), "run", "run.", origins),
        tuple(variants.values()),
    )


def _variant(body: Any, where: str, method: str, origins: Mapping[str, Origin]) -> Variant:
    if not isinstance(body, dict) or "label" not in body:
        first = next(
            (origin for key, origin in origins.items() if key.startswith(where + ".")), origins["variants"]
        )
        raise ScenarioError(f"{first}: {where} must hold a label, and may hold method and set.")
    _check_keys(body, _VARIANT_KEYS, where + ".", origins)
    # The label becomes part of a folder's name.
    label = str(body["label"])
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", label):
        place = origins[f"{where}.label"]
        raise ScenarioError(
            f"{place}: the label is {label!r}; it must be of letters, digits, '.', '_' and '-'."
        )
    if "method" in body:
        _check_text(body["method"], f"{where}.method", origins)
    settings = _settings(body.get("set", {}), f"{where}.set", "", origins)
    return Variant(label, body.get("method", method), settings)


def _settings(body: Any, where: str, prefix: str, origins: Mapping[str, Origin]) -> tuple[Setting, ...]:
    if not isinstance(body, dict):
        raise ScenarioError(
            f"{origins[where]}: {where} must hold keys and values, e.g. {{run.env_steps: 4000}}."
        )
    return tuple(
        Setting(f"{prefix}{key}={_yaml(value)}", str(origins[f"{where}.{key}"]))
        for key, value in body.items()
    )


def _yaml(value: Any) -> str:
    """A value as one would type it after --set KEY=."""
    bare = (
        isinstance(value, str) and re.fullmatch(r"[A-Za-z_][\w-]*", value) and value.lower() not in _NOT_WORDS
    )
    return value if bare else json.dumps(value)


_NOT_WORDS = ("true", "false", "null")


def _check_keys(
    body: Mapping[str, Any], known: Sequence[str], prefix: str, origins: Mapping[str, Origin]
) -> None:
    for key in body:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f"the nearest is {near[0]}" if near else f"there are {', '.join(known)}"
            raise ScenarioError(f"{origins[f'{prefix}{key}']}: there is no key {prefix}{key}; {hint}.")


def _check_text(value: Any, key: str, origins: Mapping[str, Origin]) -> None:
    if not isinstance(value, str) or not value.strip():
        raise ScenarioError(f"{origins[key]}: {key} is {value!r}; it must be a text.")
