"""`tandem log echo`."""

from typing import Annotated, Any

import typer

from tandem.cli.common import fail, sentences
from tandem.cli.log.common import EpisodesOption, LogArgument, opened, selected

FromOption = Annotated[
    float | None, typer.Option("--from", metavar="S", help="Only from so many seconds of the log on.")
]
ToOption = Annotated[
    float | None, typer.Option("--to", metavar="S", help="Only before so many seconds of the log.")
]


def echo(
    log: LogArgument,
    channel: Annotated[str, typer.Argument(help="Channel, e.g. ROBOT_STATE.")],
    fields: Annotated[
        list[str] | None,
        typer.Argument(help="Fields by path, e.g. tick F_ext_W[2] last_records[0].alpha [default: all]."),
    ] = None,
    episodes: EpisodesOption = None,
    begin_s: FromOption = None,
    end_s: ToOption = None,
    every: Annotated[int, typer.Option(help="Only each so-manieth message.", min=1)] = 1,
    limit: Annotated[int, typer.Option(help="At most so many messages; 0 = all.", min=0)] = 0,
    json_lines: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
) -> None:
    """Print messages of a channel: time (s of the log), then fields.

    The JSON objects hold time_s and the fields under their paths; a number that is not finite is null.
    """
    from tandem.log.fields import FieldError, as_json, parse, text_of, value_at

    with sentences():
        event_log = opened(log)
        if channel not in event_log.index.channels:
            fail(
                f"{event_log.path} has no channel {channel}; it has {', '.join(event_log.index.channels)}.", 2
            )
        rows = selected(event_log, event_log.index.rows(channel, readable=True), episodes, begin_s, end_s)
        rows = rows[::every]
        rows = rows[:limit] if limit else rows
        try:
            paths = {text: parse(text) for text in fields or ()}
            for row, event in zip(rows, event_log.events(rows), strict=False):
                message = event.message
                if message is None:
                    continue
                names = paths or {name: [name] for name in message.__slots__}
                shown: dict[str, Any] = {name: value_at(message, path) for name, path in names.items()}
                time_s = (int(event_log.index.utime[row]) - event_log.begin_us) / 1e6
                if json_lines:
                    print(as_json({"time_s": time_s, **shown}).decode())
                else:
                    values = "  ".join(f"{name}={text_of(value)}" for name, value in shown.items())
                    print(f"{time_s:.6f}  {values}")
        except FieldError as error:
            fail(f"{channel}: {error}", 2)
