"""Messages of one shape as a numpy record, so that many are decoded at once.

    layout = Layout.of(robot_state_t, data)
    np.frombuffer(many, layout.dtype)["F_ext_W"]     # (N, 6)

A type with arrays of variable length or strings has one layout for each choice of their lengths; `Layout.of` takes the
lengths from a sample, and `fits` tells which other messages of the same size have them too. In a run they hardly ever
change: observations stay as wide as they are.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tandem.wire import members

_PRIMITIVES = {
    "int8_t": ">i1",
    "boolean": ">i1",
    "byte": "u1",
    "int16_t": ">i2",
    "int32_t": ">i4",
    "int64_t": ">i8",
    "float": ">f4",
    "double": ">f8",
}
FINGERPRINT = "(fingerprint)"


class _NoLayoutError(Exception):
    """The message can't be a fixed record (an array of structs that differ among themselves)."""


@dataclass(frozen=True)
class Layout:
    """Where each field of a message lies, big endian, the fingerprint first."""

    dtype: np.dtype[Any]
    lengths: dict[str, int] = field(default_factory=dict)  # fields that tell a length, and their value here

    @staticmethod
    def of(message_type: Any, data: bytes) -> Layout | None:
        """Of a message like this sample; None when it is not of the type, or can't be a record."""
        if data[:8] != message_type._get_packed_fingerprint():
            return None
        lengths: dict[str, int] = {}
        try:
            dtype = _record(message_type, data, 8, lengths, True)
        except (_NoLayoutError, IndexError, ValueError):
            return None
        return Layout(dtype, lengths) if dtype.itemsize == len(data) else None

    def fits(self, records: NDArray[np.void]) -> NDArray[np.bool_]:
        """Which of these records, read in this layout, tell the same lengths."""
        same = np.ones(len(records), bool)
        for name, value in self.lengths.items():
            same &= records[name] == value
        return same


def head(message_type: Any) -> tuple[np.dtype[Any], bool]:
    """How every message of a type begins, up to its first member of variable size; whether that is all of it."""
    fields: list[tuple[Any, ...]] = [(FINGERPRINT, ">i8")]
    for name, kind, dimensions in members(message_type):
        if kind not in _PRIMITIVES or any(isinstance(size, str) for size in dimensions):
            return np.dtype(fields), False
        fields.append((name, _PRIMITIVES[kind], dimensions))
    return np.dtype(fields), True


def _record(
    message_type: Any, data: bytes, at: int, lengths: dict[str, int], outermost: bool
) -> np.dtype[Any]:
    """The dtype of a struct that begins at a byte of the sample."""
    fields: list[tuple[Any, ...]] = [(FINGERPRINT, ">i8")] if outermost else []
    values: dict[str, int] = {}  # of integers, for the dimensions that name them

    def add(name: str, dtype: Any, shape: tuple[int, ...] = ()) -> None:
        nonlocal at
        fields.append((name, dtype, shape) if shape else (name, dtype))
        at += np.dtype(dtype).itemsize * int(np.prod(shape))
        if at > len(data):
            raise IndexError

    def variable() -> None:
        if not outermost:
            raise _NoLayoutError  # elements of an array would have to agree; nobody needs it

    for name, kind, dimensions in members(message_type):
        shape = []
        for dimension in dimensions:
            if isinstance(dimension, str):
                variable()
                lengths[dimension] = values[dimension]
                dimension = values[dimension]
            shape.append(dimension)
        if kind in _PRIMITIVES:
            begin = at
            add(name, _PRIMITIVES[kind], tuple(shape))
            if not shape and kind.startswith("int"):
                values[name] = int.from_bytes(data[begin:at], "big", signed=True)
        elif kind == "string":
            variable()
            if shape:
                raise _NoLayoutError
            length = int.from_bytes(data[at : at + 4], "big", signed=True)
            if length < 1:
                raise ValueError
            add(f"({name}.length)", ">i4")
            lengths[f"({name}.length)"] = length
            add(name, f"S{length}")
        else:
            module = importlib.import_module(kind)
            add(
                name, _record(getattr(module, kind.rsplit(".", 1)[1]), data, at, lengths, False), tuple(shape)
            )
    return np.dtype(fields)


def native(values: NDArray[Any]) -> NDArray[Any]:
    """The same values in this machine's byte order; strings as text."""
    if values.dtype.kind == "S":
        return np.char.decode(np.char.rstrip(values, b"\0"), "utf-8", "replace")
    order = values.dtype.newbyteorder("=")
    if values.dtype.names or values.dtype == order:
        return values.astype(order)
    # first together, then turned round: several times faster than both at once
    return np.array(values, order="C").byteswap(inplace=True).view(order)
