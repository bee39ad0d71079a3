"""The terminal of a training that a person drives: his program has it, the training writes to a file meanwhile."""

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console

from tandem.processes import Child
from tandem.teleop import terminal

PERSONS = ("keyboard", "gamepad")  # operators who need the terminal
MOST_COMEBACKS = 3
COMEBACK_S = 2.0  # the controller has held the arm and handed it back before a person's program starts again


class LentTerminal:
    """`person` is False for operators that need no terminal; then nothing here does anything."""

    def __init__(self, operator: str) -> None:
        self.person = operator in PERSONS
        self._settings = terminal.save(sys.stdin.fileno()) if self.person else None
        self._comebacks = 0

    @contextlib.contextmanager
    def writing_to(self, file: Path) -> Iterator[Console]:
        """A console for what the training says; the person's screen shows the end of the file."""
        with file.open("a", encoding="utf-8") as text:
            yield Console(file=text)

    def take_back(self, operator: Child) -> None:
        """When the person's program has ended: mends a terminal that it could not give back itself."""
        if self._settings is not None and operator.poll() not in (None, 0):
            terminal.rescue(sys.stdin.fileno(), self._settings)

    def may_come_back(self) -> bool:
        """True, and one chance less, when the person's program may be started again."""
        if not self.person or self._comebacks == MOST_COMEBACKS:
            return False
        self._comebacks += 1
        return True
