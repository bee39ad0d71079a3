"""What the commands on logs share: finding a log, opening it, choosing episodes."""

import contextlib
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tandem.cli.common import fail

if TYPE_CHECKING:
    from tandem.log import EventLog
    from tandem.log.events import Array

LogArgument = Annotated[Path, typer.Argument(help="Event log, or a run folder.")]
EpisodesOption = Annotated[
    str | None,
    typer.Option("--episodes", metavar="A-B", help="Only these episodes: 7, 3-5 (both included), 40- or -9."),
]


def find(log: Path) -> Path:
    """An event log from a file or a run folder."""
    from tandem.run_folder import RunFolder

    log = RunFolder(log).log if log.is_dir() else log
    if not log.is_file():
        fail(f"{log} does not exist; give an event log or a run folder.", 2)
    return log


def opened(log: Path) -> "EventLog":
    """The log with its index, which is made now, or refreshed, when the log is large."""
    from tandem.log import EventLog

    path = find(log)
    with contextlib.ExitStack() as shown:
        status: Any = None

        def progress(share: float) -> None:
            nonlocal status
            if status is None:  # there is something to wait for
                from rich.console import Console

                status = shown.enter_context(Console(stderr=True).status(""))
            status.update(f"indexing {path} ... {100 * share:.0f} %")

        try:
            return EventLog(path, keep_index=True, progress=progress)
        except OSError as error:
            fail(f"{path} can't be read ({error.strerror}).", 2)


def episode_range(text: str | None) -> tuple[int, int]:
    """(first, last) of 7, 3-5, 40- or -9; everything when None."""
    if text is None:
        return 0, 1 << 62
    match = re.fullmatch(r"(\d*)(-?)(\d*)", text.strip())
    if match is None or not (match[1] or match[3]):
        fail(f"--episodes is {text!r}; it must be like 7, 3-5 (both included), 40- or -9.", 2)
    first = int(match[1] or 0)
    last = int(match[3]) if match[3] else (1 << 62 if match[2] else first)
    if last < first:
        fail(f"--episodes is {text!r}; its end lies before its beginning.", 2)
    return first, last


def no_such_episodes(log: "EventLog", text: str | None) -> str:
    """A sentence: what was asked for and what there is."""
    there = log.episodes.number
    have = f"episodes {there.min()} to {there.max()}" if len(there) else "no whole episode"
    return f"{log.path} holds no episode in {text or 'all'}; it has {have}."


def selected(
    log: "EventLog", rows: "Array", episodes: str | None, begin_s: float | None, end_s: float | None
) -> "Array":
    """Those of the events that lie in these episodes and in this time; a sentence when there are none such."""
    import numpy as np

    if episodes is not None:
        first, last = episode_range(episodes)
        wanted = np.flatnonzero((log.episodes.number >= first) & (log.episodes.number <= last))
        if not len(wanted):
            fail(no_such_episodes(log, episodes), 2)
        rows = rows[np.isin(log.episodes.of(rows), wanted)]
    if begin_s is not None or end_s is not None:
        time_s = (log.index.utime[rows] - log.begin_us) / 1e6
        low, high = begin_s or 0.0, np.inf if end_s is None else end_s
        rows = rows[(time_s >= low) & (time_s < high)]
        if not len(rows):
            latest = (log.index.utime.max() - log.begin_us) / 1e6 if len(log.index) else 0.0
            fail(f"{log.path} has nothing from {low:g} to {high:g} s; it lasts until {latest:.3f} s.", 2)
    return rows
