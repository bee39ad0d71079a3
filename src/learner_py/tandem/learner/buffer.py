"""Replay: windows of all episodes in arrays of fixed capacity on the device, rebuildable from the event log.

Rows are appended episode by episode; when `capacity` rows are full the oldest are overwritten. Arrays grow in powers of
two, so that a jitted update sees few shapes. `rows[:n_rows]` lists the rows that minibatches are drawn from.
"""

from __future__ import annotations

from dataclasses import fields
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from tandem.learner.episode import Bools
from tandem.learner.windows import Windows

Arrays = dict[str, jax.Array]

FIRST_ALLOCATION = 16_384  # rows; a usual run never grows, so it never compiles a second time
_PADDING = 128  # rows; episodes are padded to multiples of it, so that writing compiles rarely


class ReplayBuffer:
    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.size = 0  # rows in use
        self.arrays: Arrays = {}  # Windows' fields, each (allocated, ...)
        self.n_rows = 0
        self.rows: jax.Array = jnp.zeros(0, jnp.int32)  # (allocated,)
        self._position = 0  # where the next row goes
        self._eligible = np.zeros(capacity, bool)

    @property
    def allocated(self) -> int:
        return len(self.rows)

    def allocate(self, width: int, horizon: int, n_axes: int) -> None:
        """Makes the first arrays; before that the buffer has no shapes."""
        one = Windows(
            observation=np.zeros((1, width), np.float32),
            chunk=np.zeros((1, horizon, n_axes), np.float32),
            valid=np.zeros((1, horizon), bool),
            human=np.zeros((1, horizon), bool),
            mc_return=np.zeros(1, np.float32),
            next_observation=np.zeros((1, width), np.float32),
            terminated=np.zeros(1, bool),
            truncated=np.zeros(1, bool),
        )
        self._grow_to(min(FIRST_ALLOCATION, self.capacity), one)

    def add(self, windows: Windows, eligible: Bools) -> None:
        """Appends an episode. eligible (T,): rows that minibatches may hold."""
        length = len(windows.mc_return)
        if length > self.capacity:
            raise ValueError(
                f"An episode of {length} steps does not fit in a buffer of {self.capacity}; raise buffer_capacity."
            )
        while self.allocated < min(self._position + length, self.capacity):
            self._grow_to(min(2 * self.allocated, self.capacity), windows)

        row = (self._position + np.arange(length)) % self.capacity
        padded = -(-length // _PADDING) * _PADDING
        target = np.full(padded, self.allocated, np.int32)  # beyond the end: dropped
        target[:length] = row
        values = {
            field.name: np.concatenate([array, np.zeros((padded - length, *array.shape[1:]), array.dtype)])
            for field in fields(Windows)
            for array in [getattr(windows, field.name)]
        }
        self.arrays = _write(self.arrays, target, values)

        self._position = (self._position + length) % self.capacity
        self.size = min(self.size + length, self.capacity)
        self._eligible[row] = eligible
        listed = np.flatnonzero(self._eligible[: self.size]).astype(np.int32)
        self.n_rows = len(listed)
        self.rows = jnp.asarray(np.concatenate([listed, np.zeros(self.allocated - len(listed), np.int32)]))

    def sample_observations(self, count: int) -> np.ndarray:
        """Up to `count` stored raw observations (n, O), evenly spread over the buffer."""
        if self.size == 0:
            return np.zeros((0, self.arrays["observation"].shape[1]), np.float32)
        rows = np.unique(np.linspace(0, self.size - 1, count).astype(np.int32))
        return np.asarray(self.arrays["observation"][rows])

    def _grow_to(self, allocated: int, like: Windows) -> None:
        grown: Arrays = {}
        for field in fields(Windows):
            array = getattr(like, field.name)
            old = self.arrays.get(field.name)
            new = jnp.zeros((allocated, *array.shape[1:]), array.dtype)
            grown[field.name] = new if old is None else new.at[: len(old)].set(old)
        self.arrays = grown
        self.rows = jnp.zeros(allocated, jnp.int32).at[: self.allocated].set(self.rows)


@partial(jax.jit, donate_argnums=0)
def _write(arrays: Arrays, target: jax.Array, values: Arrays) -> Arrays:
    return {name: array.at[target].set(values[name], mode="drop") for name, array in arrays.items()}
