"""Observation statistics of the demonstrations, frozen at warm start: x = (observation - mean) * scale.

The same two vectors travel inside every policy file, so trainer and arm can't disagree about them. Nothing is clipped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tandem.learner.episode import Floats


@dataclass(frozen=True)
class Normalizer:
    mean: Floats  # (O,) raw units
    scale: Floats  # (O,) 1 / raw units

    @staticmethod
    def identity(width: int) -> Normalizer:
        """For runs without demonstrations."""
        return Normalizer(np.zeros(width, np.float32), np.ones(width, np.float32))

    @staticmethod
    def fit(observations: Sequence[Floats], floor: float) -> Normalizer:
        """Statistics over all steps of the demonstrations, each (T, O).

        floor: smallest standard deviation, raw units. An input that hardly moves in the demonstrations (a constant
        height, a closed gripper) would otherwise turn a small later change into a huge one.
        """
        stacked = np.concatenate(observations).astype(np.float64)
        deviation = np.maximum(stacked.std(axis=0), floor)
        return Normalizer(stacked.mean(axis=0).astype(np.float32), (1.0 / deviation).astype(np.float32))

    def apply(self, observation: Floats) -> Floats:
        """(..., O) raw -> (..., O) normalised, in float32 as the policy runtime does."""
        return (observation - self.mean) * self.scale
