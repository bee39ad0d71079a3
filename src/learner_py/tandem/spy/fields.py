"""The members of a message as a tree, and their recent values."""

from collections import deque
from collections.abc import Iterator
from typing import Any

KEPT = 60  # values of each member
_BLOCKS = "▁▂▃▄▅▆▇█"
_ASCII_BLOCKS = "_.-=^"
_SHOWN_TEXT = 60  # characters of a string


def members(message: Any) -> list[tuple[str, Any]]:
    """Names and values of a message, indices and values of an array; empty for a leaf."""
    if isinstance(message, list | tuple):
        return [(f"[{i}]", value) for i, value in enumerate(message)]
    if slots := getattr(message, "__slots__", None):
        return [(name, getattr(message, name)) for name in slots]
    return []


def numbers(message: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Every number in a message by its path: `F_ext_W[2]`, `last_records[0].alpha`."""
    for name, value in members(message):
        below = path + name if name.startswith("[") or not path else f"{path}.{name}"
        if isinstance(value, bool | int | float):
            yield below, float(value)
        else:
            yield from numbers(value, below)


def text(value: Any) -> str:
    """A leaf for people; the beginning of an array."""
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, str):
        line = value.replace("\n", " ⏎ ")
        return line if len(line) <= _SHOWN_TEXT else f"{line[:_SHOWN_TEXT]}… ({len(value)} characters)"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, list | tuple):
        if value and not isinstance(value[0], int | float):
            return f"{len(value)} items"
        shown = "  ".join(text(item) for item in value[:6])
        return shown if len(value) <= 6 else f"{shown} … ({len(value)})"
    return str(value)


def sparkline(values: Any, width: int = 24, encoding: str = "utf-8", whole: float | None = None) -> str:
    """The last values as a line of bars between their least and their greatest, or from 0 to `whole`; a flat line
    between its least and its greatest is low."""
    recent = [value for value in list(values)[-width:] if value == value]
    if not recent:
        return ""
    blocks = _BLOCKS if encoding.lower().startswith("utf") else _ASCII_BLOCKS
    low, high = (min(recent), max(recent)) if whole is None else (0.0, whole)
    recent = [min(high, max(low, value)) for value in recent]
    if not high - low < float("inf"):
        return ""
    scale = (len(blocks) - 1) / (high - low) if high > low else 0.0
    return "".join(blocks[round((value - low) * scale)] for value in recent)


class FieldHistory:
    """Recent values of every number of one channel's messages."""

    def __init__(self) -> None:
        self._values: dict[str, deque[float]] = {}

    def take(self, message: Any) -> None:
        for path, value in numbers(message):
            self._values.setdefault(path, deque(maxlen=KEPT)).append(value)

    def of(self, path: str) -> deque[float] | None:
        return self._values.get(path)
