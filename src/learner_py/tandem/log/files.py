"""The files of one log: log.lcm, and log.lcm.01, log.lcm.02 ... when its writer began new ones.

Each is an LCM event log by itself; their bytes in a row are the log that one file would be.
"""

from __future__ import annotations

import re
from pathlib import Path

from tandem.run_folder import RunFolderError


def files_of(log: Path) -> list[Path]:
    """The files that are there, in order, `log` first."""
    return [log, *dict(sorted(_following(log).items())).values()]


def missing(log: Path) -> list[str]:
    """Names of those that must have been there, for others go on after them."""
    there = _following(log)
    return [f"{log.name}.{n:02d}" for n in range(1, max(there, default=0)) if n not in there]


def refuse_leftovers(log: Path) -> None:
    """Before a log is written anew: raises RunFolderError when files are there that would be read as its own."""
    if there := _following(log):
        raise RunFolderError(
            f"{min(there.values())} would be read as what follows {log}; remove it, or give another name."
        )


def _following(log: Path) -> dict[int, Path]:
    name = re.compile(re.escape(log.name) + r"\.(\d{2,9})")
    found = ((name.fullmatch(file.name), file) for file in log.parent.iterdir())
    return {int(match[1]): file for match, file in found if match and int(match[1]) > 0}
