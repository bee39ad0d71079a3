"""What a message's JSON means: a JSON schema with the words of the .lcm file."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import tandem_lcm.tandem as types

from tandem.run_folder import ROOT
from tandem.wire import members

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


@cache
def json_schema(name: str) -> dict[str, Any]:
    """JSON schema of a message type of the package tandem, e.g. robot_state_t."""
    message_type = getattr(types, name)
    words = _comments(name)
    properties = {}
    for field, kind, dimensions in members(message_type):
        primitive = JSON_TYPES.get(kind)
        schema = {"type": primitive} if primitive else dict(json_schema(kind.rpartition(".")[2]))
        if kind == "byte":
            schema, dimensions = {"type": "string", "contentEncoding": "base64"}, ()
        for size in reversed(dimensions):
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
