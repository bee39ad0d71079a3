"""Replay: windows of all episodes in arrays of fixed capacity on the device, rebuildable from the event log.

Rows are appended episode by episode; when `capacity` rows are full the oldest are overwritten. Arrays grow in powers of
two, so that a jitted update sees few shapes. `rows` lists the rows that minibatches may be drawn from, by name of the
set: which sets there are is the method's affair.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tandem.learner.episode import Bools
from tandem.learner.windows import Windows

Arrays = dict[str, jax.Array]


class RowSet(NamedTuple):
    """Rows that a minibatch may hold: `listed[:n]`, in the order in which they came."""

    listed: jax.Array  # (allocated,) int32
    n: jax.Array  # () int32


RowSets = dict[str, RowSet]

FIRST_ALLOCATION = 16_384  # rows; a usual run never grows, so it never compiles a second time
FIRST_ALLOCATION_WITH_IMAGES = 8_192  # 200 MB with two views of 64 px
_PADDING = 128  # rows; episodes are padded to multiples of it, so that writing compiles rarely


class ReplayBuffer:
    def __init__(self, capacity: int, sets: Sequence[str]) -> None:
        self.capacity = capacity
        self.size = 0  # rows in use
        self.arrays: Arrays = {}  # Windows' fields, each (allocated, ...)
        self.allocated = 0  # rows that the arrays have
        self._position = 0  # where the next row goes
        self._members = {name: np.zeros(capacity, bool) for name in sets}
        self.rows: RowSets = {}

    def allocate(
        self,
        width: int,
        horizon: int,
        n_axes: int,
        image_size: tuple[int, int] | None = None,
        next_images: bool = False,
    ) -> None:
        """Makes the first arrays; before that the buffer has no shapes. Images (height, width) take most of the memory:
        24 KB a row with two views of 64 px, twice that with next_images."""
        black = None if image_size is None else np.zeros((1, *image_size, 3), np.uint8)
        one = Windows(
            observation=np.zeros((1, width), np.float32),
            chunk=np.zeros((1, horizon, n_axes), np.float32),
            valid=np.zeros((1, horizon), bool),
            human=np.zeros((1, horizon), bool),
            mc_return=np.zeros(1, np.float32),
            next_observation=np.zeros((1, width), np.float32),
            n_step_return=np.zeros(1, np.float32),
            bootstrap=np.zeros(1, np.float32),
            image=black,
            rest=None if black is None else np.zeros((1, 6), np.float32),
            next_image=black if next_images else None,
        )
        first = FIRST_ALLOCATION if image_size is None else FIRST_ALLOCATION_WITH_IMAGES
        self._grow_to(min(first, self.capacity), one)

    def add(self, windows: Windows, sets: Mapping[str, Bools]) -> None:
        """Appends an episode. sets: which of its rows (T,) belong to each set."""
        length = len(windows.mc_return)
        if length > self.capacity:
            raise ValueError(
                f"An episode of {length} steps does not fit in a buffer of {self.capacity}; raise replay.capacity."
            )
        while self.allocated < min(self._position + length, self.capacity):
            self._grow_to(min(2 * self.allocated, self.capacity), windows)

        row = (self._position + np.arange(length)) % self.capacity
        padded = -(-length // _PADDING) * _PADDING
        target = np.full(padded, self.allocated, np.int32)  # beyond the end: dropped
        target[:length] = row
        values = {
            name: np.concatenate([array, np.zeros((padded - length, *array.shape[1:]), array.dtype)])
            for name, array in windows.columns().items()
        }
        self.arrays = _write(self.arrays, target, values)

        self._position = (self._position + length) % self.capacity
        self.size = min(self.size + length, self.capacity)
        for name, members in self._members.items():
            members[row] = sets[name]
        self._list_rows()

    def count(self, name: str) -> int:
        """Rows in a set."""
        return int(self._members[name][: self.size].sum())

    def _list_rows(self) -> None:
        # from the oldest row on; before the first overwriting that is row 0
        oldest = self._position if self.size == self.capacity else 0
        for name, members in self._members.items():
            listed = np.flatnonzero(np.roll(members[: self.size], -oldest))
            listed = (listed + oldest) % max(self.size, 1)
            padded = np.zeros(self.allocated, np.int32)
            padded[: len(listed)] = listed
            self.rows[name] = RowSet(jnp.asarray(padded), jnp.int32(len(listed)))

    def sha256(self) -> str:
        """Hex digest over everything that a minibatch can be drawn from: equal digests, equal training."""
        digest = hashlib.sha256()
        for name, array in sorted(self.arrays.items()):
            rows = np.asarray(array[: self.size])
            digest.update(f"{name} {rows.dtype.str} {rows.shape} ".encode())
            digest.update(np.ascontiguousarray(rows).tobytes())
        for name, row_set in sorted(self.rows.items()):
            digest.update(f"{name} {int(row_set.n)} ".encode())
            digest.update(np.asarray(row_set.listed[: int(row_set.n)]).tobytes())
        return digest.hexdigest()

    def sample_observations(self, count: int) -> np.ndarray:
        """Up to `count` stored raw observations (n, O), evenly spread over the buffer."""
        if self.size == 0:
            return np.zeros((0, self.arrays["observation"].shape[1]), np.float32)
        rows = np.unique(np.linspace(0, self.size - 1, count).astype(np.int32))
        return np.asarray(self.arrays["observation"][rows])

    def _grow_to(self, allocated: int, like: Windows) -> None:
        grown: Arrays = {}
        for name, array in like.columns().items():
            old = self.arrays.get(name)
            new = jnp.zeros((allocated, *array.shape[1:]), array.dtype)
            grown[name] = new if old is None else new.at[: len(old)].set(old)
        self.arrays = grown
        self.allocated = allocated
        self._list_rows()


@partial(jax.jit, donate_argnums=0)
def _write(arrays: Arrays, target: jax.Array, values: Arrays) -> Arrays:
    return {name: array.at[target].set(values[name], mode="drop") for name, array in arrays.items()}
