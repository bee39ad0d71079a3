"""A person at a pseudo-terminal: starts a program in it, types, looks."""

import contextlib
import fcntl
import os
import pty
import signal
import struct
import termios
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any


def wait_for(condition: Callable[[], Any], seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.01)


class Person:
    """The program has the pseudo-terminal as its controlling terminal. A context."""

    def __init__(self, command: Sequence[str], environment: dict[str, str] | None = None) -> None:
        self._seen = b""
        self._kitty_answer = b""
        self.code: int | None = None
        self.pid, self.master = pty.fork()
        if self.pid == 0:
            os.environ.update({"TERM": "xterm-256color", "LANG": "C.UTF-8", **(environment or {})})
            os.execvp(command[0], list(command))
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", 50, 140, 0, 0))
        self.settings = termios.tcgetattr(self.master)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> "Person":
        return self

    def __exit__(self, *_: object) -> None:
        if self.code is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            self.wait()
        with contextlib.suppress(OSError):
            os.close(self.master)

    def _read(self) -> None:
        while True:
            try:
                data = os.read(self.master, 65536)
            except OSError:
                return
            if not data:
                return
            self._seen += data

    @property
    def seen(self) -> str:
        return self._seen.decode("utf-8", "replace")

    def see(self, text: str, seconds: float = 20.0) -> None:
        try:
            wait_for(lambda: text in self.seen, seconds)
        except AssertionError:
            raise AssertionError(f"{text!r} was not seen in {self.seen[-3000:]}") from None

    def type(self, keys: str | bytes) -> None:
        os.write(self.master, keys.encode() if isinstance(keys, str) else keys)

    def hold(self, key: str | bytes, seconds: float, interval_s: float = 0.03) -> None:
        """As a plain terminal repeats it, without the first delay."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.type(key)
            time.sleep(interval_s)

    def hang_up(self) -> None:
        """The terminal's window is closed."""
        os.close(self.master)

    def wait(self, seconds: float = 20.0) -> int:
        deadline = time.monotonic() + seconds
        while self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
            elif time.monotonic() > deadline:
                os.kill(self.pid, signal.SIGKILL)
                raise AssertionError(f"it did not end; seen: {self.seen[-2000:]}")
            else:
                time.sleep(0.01)
        return self.code

    @property
    def restored(self) -> bool:
        """The terminal's settings are those that it began with."""
        return termios.tcgetattr(self.master) == self.settings
