"""How a LeRobot checkpoint normalises inputs and actions, as x = (value - mean) scale + shift.

Older checkpoints keep the statistics as buffers among the weights; newer ones in processors beside them: JSON files
of steps, each with its own settings and safetensors file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tandem.lerobot_act.read import read_json
from tandem.policy_file import Array, PolicyFileError, read_safetensors

OLD_EPSILON = 1e-8  # also the default of the newer ones
# The bounds that a mode maps to -1 and 1.
RANGES = {"MIN_MAX": ("min", "max"), "QUANTILES": ("q01", "q99"), "QUANTILE10": ("q10", "q90")}
MODES = ("IDENTITY", "MEAN_STD", *RANGES)

# Steps that change no number, and those whose numbers we take over.
NEUTRAL_STEPS = ("rename_observations_processor", "to_batch_processor", "device_processor")
NORMALIZERS = {
    "policy_preprocessor.json": "normalizer_processor",
    "policy_postprocessor.json": "unnormalizer_processor",
}


@dataclass(frozen=True)
class Affine:
    """x = (value - mean) scale + shift, all (n) in double."""

    mean: Array
    scale: Array
    shift: float


@dataclass(frozen=True)
class Normalizer:
    """One side, inputs or actions: which mode each kind of feature has, and the statistics of every key."""

    place: str  # for sentences
    modes: Mapping[str, str]  # STATE, ENV, VISUAL, ACTION -> mode; a kind that is not named is left as it is
    statistics: Mapping[str, Array]  # "observation.state.mean" ...
    epsilon: float
    always_adds: (
        bool  # older MIN_MAX adds epsilon to every range, newer ones only replace an empty range by it
    )
    only: frozenset[str] | None = None  # keys that are normalised; None: all

    def mode(self, key: str, kind: str) -> str:
        mode = self.modes.get(kind, "IDENTITY")
        if mode not in MODES:
            raise PolicyFileError(
                f"{self.place}: the normalisation of {kind} is {mode!r}; known are {', '.join(MODES)}."
            )
        return "IDENTITY" if self.only is not None and key not in self.only else mode

    def of_input(self, key: str, kind: str, size: int) -> Affine:
        mode = self.mode(key, kind)
        if mode == "IDENTITY":
            return Affine(np.zeros(size), np.ones(size), 0.0)
        if mode == "MEAN_STD":
            mean, deviation = self._take(key, "mean", size), self._take(key, "std", size)
            return Affine(mean, 1.0 / (deviation + self.epsilon), 0.0)
        low, width = self._range(key, mode, size)
        width = width + self.epsilon if self.always_adds else np.where(width == 0, self.epsilon, width)
        return Affine(low, 2.0 / width, -1.0)

    def of_action(self, size: int) -> dict[str, Array]:
        """scale and offset (n): action = output scale + offset."""
        mode = self.mode("action", "ACTION")
        if mode == "IDENTITY":
            return {"scale": np.ones(size), "offset": np.zeros(size)}
        if mode == "MEAN_STD":
            return {"scale": self._take("action", "std", size), "offset": self._take("action", "mean", size)}
        low, width = self._range("action", mode, size)
        if not self.always_adds:
            width = np.where(width == 0, self.epsilon, width)
        return {"scale": width / 2, "offset": low + width / 2}

    def _range(self, key: str, mode: str, size: int) -> tuple[Array, Array]:
        low, high = (self._take(key, name, size) for name in RANGES[mode])
        return low, high - low

    def _take(self, key: str, statistic: str, size: int) -> Array:
        array = self.statistics.get(f"{key}.{statistic}")
        if array is None:
            raise PolicyFileError(
                f"{self.place}: the statistic {statistic} of {key} is missing; the checkpoint was saved without it. "
                "Copy all files of the checkpoint, or save it once more with the dataset's statistics."
            )
        if array.size != size:
            raise PolicyFileError(
                f"{self.place}: the statistic {statistic} of {key} has {array.size} numbers; it must have {size}."
            )
        if not np.isfinite(array).all():
            raise PolicyFileError(
                f"{self.place}: the statistic {statistic} of {key} is not finite; it was never filled from a dataset. "
                "Save the checkpoint with the dataset's statistics."
            )
        return array.reshape(size).astype(np.float64)


@dataclass(frozen=True)
class Normalizers:
    inputs: Normalizer
    action: Normalizer


def read_normalizers(source: Path, settings: Mapping[str, Any], tensors: Mapping[str, Array]) -> Normalizers:
    """tensors: of model.safetensors. Raises PolicyFileError."""
    if (source / "policy_preprocessor.json").is_file():
        return Normalizers(*(_processor(source, file, step) for file, step in NORMALIZERS.items()))
    modes = settings.get("normalization_mapping") or {}

    def buffers(prefix: str, keys: list[str]) -> Normalizer:
        names = {prefix + key.replace(".", "_"): key for key in keys}  # a dot can't stand in a module's name
        found = {
            f"{names[owner]}.{statistic}": array
            for owner, _, statistic, array in (
                (*name.rpartition("."), array) for name, array in tensors.items()
            )
            if owner in names
        }
        return Normalizer(str(source / "model.safetensors"), modes, found, OLD_EPSILON, always_adds=True)

    return Normalizers(
        buffers("normalize_inputs.buffer_", list(settings["input_features"])),
        buffers("unnormalize_outputs.buffer_", ["action"]),
    )


def _processor(source: Path, file: str, wanted: str) -> Normalizer:
    """The normalising step of a processor; any other step that changes numbers is refused."""
    path = source / file
    try:
        found = None
        for step in read_json(path)["steps"]:
            name = step.get("registry_name", step.get("class"))
            if name == wanted and found is None:
                found = step
            elif name not in NEUTRAL_STEPS:
                raise PolicyFileError(
                    f"{path}: it has the step {name!r}; only {wanted}, once, and steps that change no number "
                    "can be taken over. Do what that step does outside of the policy."
                )
        if found is None:
            return Normalizer(str(path), {}, {}, OLD_EPSILON, always_adds=False)
        config, state = found["config"], found.get("state_file")
        only = config.get("normalize_observation_keys")
        known = frozenset(config["features"])
        statistics: dict[str, Array] = {}
        if state is not None:
            statistics, _ = read_safetensors(source / Path(state).name)
        return Normalizer(
            str(path),
            config["norm_map"],
            statistics,
            float(config.get("eps", OLD_EPSILON)),
            always_adds=False,
            only=known if only is None else known & frozenset(only),
        )
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise PolicyFileError(f"{path} is not one of LeRobot's processors: {error!r}.") from None
