"""The terminal, lent for a while: keys one by one and unechoed, given back as it was whatever happens."""

import contextlib
import os
import termios
from collections.abc import Iterator
from typing import Any

from tandem.teleop.keys import Key, KeyDecoder

# Report focus, mark pasted text, ask for the kitty protocol (a terminal that does not have it stays silent).
_BEGIN = b"\x1b[?1004h\x1b[?2004h\x1b[?u"
_END = b"\x1b[?2004l\x1b[?1004l"
_KITTY_BEGIN = b"\x1b[>11u"  # tell keys apart, tell of repeats and releases, tell of all keys so
_KITTY_END = b"\x1b[<u"
_LEAVE_SCREEN = b"\x1b[?1049l\x1b[?25h"  # the ordinary screen, cursor shown

_I, _L, _CC = 0, 3, 6  # places in what tcgetattr gives


class TerminalLost(Exception):
    """It was closed."""


def save(fd: int) -> list[Any] | None:
    """Settings of the terminal, None when it is none."""
    try:
        return termios.tcgetattr(fd)
    except termios.error:
        return None


def restore(fd: int, settings: list[Any]) -> None:
    """Back to the settings; what was typed meanwhile is dropped. A terminal that is gone is no error."""
    with contextlib.suppress(termios.error, OSError):
        termios.tcflush(fd, termios.TCIFLUSH)
        termios.tcsetattr(fd, termios.TCSANOW, settings)


def rescue(fd: int, settings: list[Any]) -> None:
    """After a program that died with the terminal in its hands."""
    with contextlib.suppress(OSError):
        os.write(fd, _KITTY_END + _END + _LEAVE_SCREEN)
    restore(fd, settings)


@contextlib.contextmanager
def raw(fd: int) -> Iterator[None]:
    """Keys come one by one, Ctrl-C among them; output is as always."""
    saved = termios.tcgetattr(fd)
    settings = termios.tcgetattr(fd)
    settings[_I] &= ~(termios.ICRNL | termios.INLCR | termios.IXON)
    settings[_L] &= ~(termios.ICANON | termios.ECHO | termios.ISIG | termios.IEXTEN)
    settings[_CC][termios.VMIN], settings[_CC][termios.VTIME] = 1, 0
    termios.tcsetattr(fd, termios.TCSANOW, settings)
    try:
        yield
    finally:
        restore(fd, saved)


class Keys:
    """Key events of a terminal in raw mode. A context, entered after the screen that it belongs to."""

    def __init__(self, fd_in: int, fd_out: int) -> None:
        self._in, self._out = fd_in, fd_out
        self._decoder = KeyDecoder()
        self._kitty = False

    def __enter__(self) -> "Keys":
        os.write(self._out, _BEGIN)
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            os.write(self._out, (_KITTY_END if self._kitty else b"") + _END)

    def fileno(self) -> int:
        return self._in

    def read(self, now: float) -> list[Key]:
        """What was typed; call it when the file is readable. @raises TerminalLost"""
        try:
            data = os.read(self._in, 4096)
        except OSError:
            data = b""
        if not data:
            raise TerminalLost
        keys = self._decoder.feed(data, now)
        if any(key.name == "kitty" for key in keys) and not self._kitty:
            self._kitty = True
            os.write(self._out, _KITTY_BEGIN)
        return keys
