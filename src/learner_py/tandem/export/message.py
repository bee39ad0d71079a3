"""LCM messages as JSON, and what the JSON means: a JSON schema with the words of the .lcm file."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Any

import tandem_lcm.tandem as types
from pydantic_core import to_json

from tandem.run_folder import ROOT

_INTEGERS = ("byte", "int8_t", "int16_t", "int32_t", "int64_t")
JSON_TYPES = {  # of the primitive types; others are messages inside messages
    "float": "number",
    "double": "number",
    "string": "string",
    "boolean": "boolean",
    **dict.fromkeys(_INTEGERS, "integer"),
}
_FIELD = re.compile(r"^\s*[\w.]+\s+(\w+)(?:\[\w+\])*;\s*//\s*(.*)$")
_MORE = re.compile(r"^\s+//\s?(.*)$")


def as_dict(message: Any) -> dict[str, Any]:
    """Fields by name. A number that is none (NaN: nothing to average) is left out, JSON has no word for it."""
    message_type: Any = type(message)
    names, read, fractions = _reader(message_type)
    values = dict(zip(names, read(message), strict=True))
    for name in fractions:
        if values[name] != values[name]:
            del values[name]
    return values


@cache
def _reader(message_type: Any) -> tuple[list[str], Callable[[Any], tuple[Any, ...]], list[str]]:
    """Names of the fields, what reads them all at once, and names of those that are one floating-point number."""
    names = message_type.__slots__
    kinds = zip(names, message_type.__typenames__, message_type.__dimensions__, strict=True)
    fractions = [name for name, kind, sizes in kinds if kind in ("float", "double") and sizes is None]
    return names, attrgetter(*names), fractions


def as_json(message: Any) -> bytes:
    return to_json(as_dict(message), fallback=as_dict, inf_nan_mode="null")


@cache
def json_schema(name: str) -> dict[str, Any]:
    """JSON schema of a message type of the package tandem, e.g. robot_state_t."""
    message_type = getattr(types, name)
    words = _comments(name)
    properties = {}
    for field, kind, dimensions in zip(
        message_type.__slots__, message_type.__typenames__, message_type.__dimensions__, strict=True
    ):
        primitive = JSON_TYPES.get(kind)
        schema = {"type": primitive} if primitive else dict(json_schema(kind.rpartition(".")[2]))
        for size in reversed(dimensions or []):
            schema = {"type": "array", "items": schema}
            if isinstance(size, int):
                schema |= {"minItems": size, "maxItems": size}
        properties[field] = schema | ({"description": words[field]} if field in words else {})
    return {"title": f"tandem.{name}", "type": "object", "properties": properties}


def _comments(name: str) -> dict[str, str]:
    """Field -> the comment beside it: unit, frame, sign."""
    words: dict[str, str] = {}
    field = None
    for line in (ROOT / "lcm_types" / f"{name}.lcm").read_text(encoding="utf-8").splitlines():
        if match := _FIELD.match(line):
            field = match[1]
            words[field] = match[2].strip()
        elif field and (match := _MORE.match(line)):
            words[field] += " " + match[1].strip()
        else:
            field = None
    return words
