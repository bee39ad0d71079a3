"""Fields of messages by path: `F_ext_W[2]`, `last_records[0].alpha`."""

from __future__ import annotations

import difflib
import math
import re
from typing import Any

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


def plain(value: Any) -> Any:
    """The same in lists, dicts, numbers and texts that JSON knows; a number that is not finite becomes null."""
    if hasattr(type(value), "__slots__") and not isinstance(value, int | float | str | bytes | list | tuple):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def text_of(value: Any) -> str:
    """For a person: numbers with six digits, structs as field=value."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}={text_of(item)}" for name, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + " ".join(text_of(item) for item in value) + "]"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "nan" if value is None else str(value)
