"""Gains of the impedance law as a message, from what a person types on top of a scenario's section `law`."""

import math
from typing import Any

import numpy as np
from tandem_lcm.tandem.impedance_gains_t import impedance_gains_t


def message(
    law: dict[str, Any],
    stiffness: str | None,
    damping_ratio: float | None,
    error_clip: str | None,
    axes: str | None,
) -> impedance_gains_t:
    """@raises ValueError with a sentence: value, limit."""
    wanted = impedance_gains_t()
    chosen = axes or law.get("axes", "base")
    if chosen not in ("base", "tool"):
        raise ValueError(f"--axes is {chosen}; it must be base or tool.")
    wanted.tool_axes = int(chosen == "tool")
    wanted.stiffness = _matrix("--stiffness", _numbers("--stiffness", stiffness) or law["stiffness"])
    if damping_ratio is None and "damping" in law:
        wanted.damping_ratio = -1.0
        wanted.damping = _matrix("damping", law["damping"])
    else:
        ratio = law["damping_ratio"] if damping_ratio is None else damping_ratio
        if not 0.0 <= ratio < math.inf:
            raise ValueError(f"--damping-ratio is {ratio}; it must be 0 or more.")
        wanted.damping_ratio = ratio
    both = _numbers("--error-clip", error_clip) or law.get("error_clip")
    wanted.error_clip_low = _clip(both or law["error_clip_low"])
    wanted.error_clip_high = _clip(both or law["error_clip_high"])
    return wanted


def _numbers(option: str, text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise ValueError(f"{option} is {text!r}; it must be numbers with commas between them.") from None


def _matrix(option: str, numbers: list[float]) -> list[list[float]]:
    if len(numbers) == 6:
        matrix = np.diag(np.asarray(numbers, float))
    elif len(numbers) == 36:
        matrix = np.asarray(numbers, float).reshape(6, 6)
    else:
        raise ValueError(f"{option} has {len(numbers)} numbers; it must have 6 or 36.")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{option} holds a number that is not finite.")
    if not np.allclose(matrix, matrix.T):
        raise ValueError(f"{option} is not symmetric.")
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest < -1e-9:
        raise ValueError(f"{option} has the eigenvalue {smallest:.3g}; none may be below 0.")
    return [[float(value) for value in row] for row in matrix]


def _clip(numbers: list[float]) -> list[float]:
    if len(numbers) != 6 or not all(0.0 <= value < math.inf for value in numbers):
        raise ValueError(f"--error-clip is {numbers}; it must be 6 numbers of 0 or more.")
    return [float(value) for value in numbers]
