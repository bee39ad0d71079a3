"""Wall time of a run by its parts, over interruptions."""

import contextlib
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tandem.run_folder import write_json


@dataclass
class Clock:
    """Wall seconds by part of the run, kept in RUN/clock.json over interruptions."""

    file: Path
    value: dict[str, Any] = field(default_factory=dict)
    _last: float = field(default_factory=time.monotonic)
    _saved: float = 0.0

    def __post_init__(self) -> None:
        empty = {
            "seconds": {},
            "checkpoints": {},
            "updates_per_s": {"sum": 0.0, "n": 0},
            "overruns": 0,
            "resumed": 0,
        }
        with contextlib.suppress(OSError, ValueError):
            empty.update(json.loads(self.file.read_text()))
        self.value = empty

    def spend(self, part: str) -> None:
        """Books the time since the last call under `part`; writes the file every few seconds."""
        now = time.monotonic()
        self.value["seconds"][part] = self.value["seconds"].get(part, 0.0) + now - self._last
        self._last = now
        if now - self._saved > 3.0:
            self.save()

    def save(self) -> None:
        self._saved = time.monotonic()
        # a full disk stops the run by the controller's or the learner's sentence, not by a stop-watch
        with contextlib.suppress(OSError):
            write_json(self.file, self.value)
