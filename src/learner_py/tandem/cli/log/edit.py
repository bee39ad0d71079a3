"""`tandem log cut|merge`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from tandem.cli.common import fail, sentences
from tandem.cli.log.common import EpisodesOption, LogArgument, find, opened, selected
from tandem.cli.log.echo import FromOption, ToOption

if TYPE_CHECKING:
    from tandem.log import EventLog

OutArgument = Annotated[Path, typer.Argument(metavar="OUT", help="Event log to write.")]


def cut(
    log: LogArgument,
    out: OutArgument,
    episodes: EpisodesOption = None,
    begin_s: FromOption = None,
    end_s: ToOption = None,
) -> None:
    """Write some episodes, or some seconds, of a log to a log of their own.

    It begins with the scenario, and with the gains and the policy that held then; so it can be looked into, replayed,
    drawn and learnt from like any other.
    """
    from tandem.log.edit import cut as write_cut

    if episodes is None and begin_s is None and end_s is None:
        fail("cut needs to know what: --episodes A-B, or --from S and --to S.", 2)
    with sentences():
        source = opened(log)
        rows = selected(source, source.index.rows(), episodes, begin_s, end_s)
        _refuse_itself(out, source)
        try:
            n = write_cut(source, rows, out)
        except OSError as error:
            fail(f"{out} can't be written ({error.strerror}).")
    print(f"{out}: {n} events, {out.stat().st_size / 1e6:.1f} MB")


def merge(
    out: OutArgument,
    logs: Annotated[list[Path], typer.Argument(help="Event logs or run folders, two or more.")],
    by: Annotated[
        Literal["timestamp", "utime"],
        typer.Option(
            help="Order: when events were written (timestamp), or when their messages were made (utime), which logs"
            " of different recorders have in common."
        ),
    ] = "timestamp",
) -> None:
    """Write several logs into one, in the order of time; the order within each log stays.

    For instance what lcm-logger recorded beside a run into the run's own log (--by utime).
    """
    from tandem.log import EventLog
    from tandem.log.edit import merge as write_merged

    if len(logs) < 2:
        fail(f"merge needs two logs or more to write into {out}; {len(logs)} was given.", 2)
    with sentences():
        sources = [EventLog(find(log)) for log in logs]
        for source in sources:
            _refuse_itself(out, source)
        try:
            n = write_merged(sources, out, by)
        except OSError as error:
            fail(f"{out} can't be written ({error.strerror}).")
    print(f"{out}: {n} events, {out.stat().st_size / 1e6:.1f} MB")
    seen: dict[int, Path] = {}
    for source in sources:
        for number in source.episodes.number.tolist():
            if seen.setdefault(number, source.path) != source.path:
                print(
                    f"Note: episode {number} (and maybe more) ends in {seen[number]} and in {source.path};"
                    " what learns from the log takes the first."
                )
                return


def _refuse_itself(out: Path, source: "EventLog") -> None:
    if out.exists() and any(out.samefile(file) for file in source.index.files):
        fail(f"{out} is the log that is read; give another name.", 2)
    if not out.parent.is_dir():
        fail(f"{out.parent} does not exist; make the folder first.", 2)
