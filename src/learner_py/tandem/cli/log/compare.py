"""`tandem log compare`."""

import re
from typing import Annotated

import typer

from tandem.cli.common import JsonOption, fail, sentences, write_json
from tandem.cli.log.common import LogArgument, find


def compare(
    a: LogArgument,
    b: LogArgument,
    channel: Annotated[
        str, typer.Option(help="Only channels that match this regular expression, whole.")
    ] = ".*",
    json_file: JsonOption = None,
) -> None:
    """Compare two logs event by event, bit for bit; exit code 1 and the first difference when not equal.

    Left out: the times at which events were written, and fields named wall_*, which are measured on the
    machine's clock.
    """
    from tandem.log.compare import first_difference

    with sentences():
        try:
            events, difference = first_difference(find(a), find(b), channel)
        except re.error as error:
            fail(f"--channel is {channel!r}, which is no regular expression ({error}).", 2)
    write_json(
        json_file,
        {"a": str(a), "b": str(b), "equal": difference is None, "events": events, "difference": difference},
    )
    if difference:
        print(f"different: {difference}")
        raise typer.Exit(1)
    print(f"equal: {events} events")
