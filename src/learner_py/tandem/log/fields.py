"""Fields of messages: by path (`F_ext_W[2]`, `last_records[0].alpha`), as JSON, for a person."""

from __future__ import annotations

import base64
import difflib
import re
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Any

from pydantic_core import to_json

from tandem.wire import members

Path = list[str | int]


class FieldError(Exception):
    """A sentence: which path, what there is instead."""


def parse(text: str) -> Path:
    """`a.b[2]` -> ["a", "b", 2]."""
    parts: Path = []
    at = 0
    for match in re.finditer(r"\.?([A-Za-z_]\w*)|\[(\d+)\]", text):
        if match.start() != at or (match[1] and match[0].startswith(".") == (at == 0)):
            break
        parts.append(match[1] or int(match[2]))
        at = match.end()
    if at != len(text) or not parts or isinstance(parts[0], int):
        raise FieldError(f"'{text}' is no field; write it like F_ext_W, F_ext_W[2] or last_records[0].alpha.")
    return parts


def value_at(message: Any, path: Path) -> Any:
    """The value there; raises FieldError with what there is instead."""
    value, seen = message, type(message).__name__
    for part in path:
        if isinstance(part, int):
            if not isinstance(value, list | tuple):
                raise FieldError(f"{seen} is no list; leave out [{part}].")
            if part >= len(value):
                raise FieldError(f"{seen} has {len(value)} elements; [{part}] is not among them.")
            value, seen = value[part], f"{seen}[{part}]"
            continue
        names = getattr(type(value), "__slots__", ())
        if part not in names:
            near = difflib.get_close_matches(part, names, 1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(names) or 'none'}."
            raise FieldError(f"{seen} has no field {part}; {hint}")
        value, seen = getattr(value, part), f"{seen}.{part}"
    return value


def as_dict(message: Any) -> dict[str, Any]:
    """Fields by name. A number that is none (NaN: nothing to average) is left out, JSON has no word for it; bytes
    (an image) are base64."""
    message_type: Any = type(message)
    names, read, fractions, images = _reader(message_type)
    values = dict(zip(names, read(message), strict=True))
    for name in images:
        values[name] = base64.b64encode(values[name]).decode()
    for name in fractions:
        if values[name] != values[name]:
            del values[name]
    return values


@cache
def _reader(message_type: Any) -> tuple[list[str], Callable[[Any], tuple[Any, ...]], list[str], list[str]]:
    """Names of the fields, what reads them all at once, names of those that are one floating-point number, and of
    those that are bytes."""
    names = message_type.__slots__
    of_type = members(message_type)
    fractions = [m.name for m in of_type if m.kind in ("float", "double") and not m.dimensions]
    images = [m.name for m in of_type if m.kind == "byte" and m.dimensions]
    return names, attrgetter(*names), fractions, images


def as_json(value: Any) -> bytes:
    """Of a message, or of lists and dicts with messages in them; what is not finite in these is null."""
    return to_json(value, fallback=as_dict, inf_nan_mode="null")


def text_of(value: Any) -> str:
    """For a person: numbers with six digits, structs as field=value."""
    if names := getattr(type(value), "__slots__", None):
        return "{" + ", ".join(f"{name}={text_of(getattr(value, name))}" for name in names) + "}"
    if isinstance(value, list | tuple):
        return "[" + " ".join(text_of(item) for item in value) + "]"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"  # an image; nobody reads its numbers
    return f"{value:.6g}" if isinstance(value, float) else str(value)
