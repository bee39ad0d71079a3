"""What a terminal sends, as key events.

Understands the plain codes of any terminal and the kitty keyboard protocol (press, repeat and release of every key:
https://sw.kovidgoyal.net/kitty/keyboard-protocol). Pasted text and codes that we don't know are swallowed whole: a
piece of them must never move the arm.
"""

import re
from dataclasses import dataclass
from enum import Enum

ESCAPE_S = 0.05  # an escape character alone for so long was the key, not the head of a sequence


class Kind(Enum):
    press = 1
    repeat = 2
    release = 3


@dataclass(frozen=True)
class Key:
    """One event. Plain terminals know presses only, and repeat them while the key is down.

    `name` is the character in lower case, or a word (enter, space, up, ctrl+c). Three names are not keys: `focus` and
    `blur` (the window got or lost the keyboard), `kitty` (the terminal answers that it speaks the protocol).
    """

    name: str
    kind: Kind = Kind.press


_CONTROL = {9: "tab", 10: "enter", 13: "enter", 8: "backspace", 27: "escape", 32: "space", 127: "backspace"}
_LETTERS = {"A": "up", "B": "down", "C": "right", "D": "left", "H": "home", "F": "end"}
_TILDES = {"2": "insert", "3": "delete", "5": "pageup", "6": "pagedown"}
_CSI = re.compile(rb"\x1b\[([0-?]*)[ -/]*([@-~])")
_CSI_BEGUN = re.compile(rb"\x1b(\[[0-?]*[ -/]*|O)?")
_PASTE_END = b"\x1b[201~"
_CTRL = 4  # bit of the kitty protocol's modifiers
_FUNCTIONAL = range(57344, 63744)  # kitty's codes of keys without a character, shift and caps lock among them


class KeyDecoder:
    """Bytes in pieces of any size -> keys."""

    def __init__(self) -> None:
        self._rest = b""
        self._since = 0.0  # s, when the rest was left
        self._pasting = False

    def feed(self, data: bytes, now: float) -> list[Key]:
        """Keys in `data`; `now` in s tells an escape key from a sequence that was cut."""
        if self._rest == b"\x1b" and now - self._since > ESCAPE_S:
            self._rest = b""
        data = self._rest + data
        keys: list[Key] = []
        while data:
            if self._pasting:
                _, ended, after = data.partition(_PASTE_END)
                if not ended:
                    data = data[-len(_PASTE_END) + 1 :]
                    break
                self._pasting, data = False, after
            elif data[0] == 0x1B:
                if _CSI_BEGUN.fullmatch(data):
                    break  # the rest is still to come
                data = self._escape(data, keys)
            else:
                length = _character_length(data)
                if len(data) < length:
                    break
                keys += _plain(data[:length])
                data = data[length:]
        self._rest, self._since = data, now
        return keys

    def _escape(self, data: bytes, keys: list[Key]) -> bytes:
        """One sequence off the front; returns what follows it."""
        if match := _CSI.match(data):
            parameters, final = match[1].decode("ascii"), match[2].decode("ascii")
            if (parameters, final) == ("200", "~"):
                self._pasting = True
            elif key := _control_sequence(parameters, final):
                keys.append(key)
            return data[match.end() :]
        if data[1:2] == b"O":
            if name := _LETTERS.get(data[2:3].decode("latin-1")):
                keys.append(Key(name))
            return data[3:]
        return data[2:] if data[1:2] != b"\x1b" else data[1:]  # alt and a character: not ours


def _character_length(data: bytes) -> int:
    """Bytes of the UTF-8 character in front; 1 for a byte that begins none."""
    first = data[0]
    length = 1 if first < 0xC0 or first >= 0xF8 else 2 if first < 0xE0 else 3 if first < 0xF0 else 4
    return length if all(0x80 <= byte < 0xC0 for byte in data[1:length]) else 1


def _plain(data: bytes) -> list[Key]:
    if len(data) == 1 and (name := _CONTROL.get(data[0])):
        return [Key(name)]
    if len(data) == 1 and data[0] < 27:
        return [Key("ctrl+" + chr(data[0] + 96))]
    try:
        return [Key(data.decode("utf-8").lower())]
    except UnicodeDecodeError:
        return []


def _control_sequence(parameters: str, final: str) -> Key | None:
    if final in "IO" and not parameters:
        return Key("focus" if final == "I" else "blur")
    if final == "u" and parameters.startswith("?"):
        return Key("kitty")
    if parameters.startswith(("?", "<", ">", "=")):
        return None
    fields = parameters.split(";")
    modifiers, _, event = (fields[1] if len(fields) > 1 else "").partition(":")
    try:
        control = (int(modifiers or 1) - 1) & _CTRL
        kind = Kind(int(event or 1))
        name = _LETTERS.get(final) or (_TILDES.get(fields[0]) if final == "~" else None)
        if final == "u":
            code = int(fields[0].partition(":")[0])
            name = _CONTROL.get(code) or (chr(code).lower() if code not in _FUNCTIONAL else None)
    except (ValueError, OverflowError):
        return None
    if name is None:
        return None
    return Key("ctrl+" + name if control else name, kind)
