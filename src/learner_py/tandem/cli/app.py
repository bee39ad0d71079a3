"""All commands of ./tandem."""

import os
import sys

import typer

from tandem import __version__
from tandem.cli import (
    ablate,
    bench,
    command,
    demo,
    diagnose,
    doctor,
    evaluate,
    export,
    import_,
    log,
    policy,
    replay,
    report,
    spy,
    table,
    teleop,
    test,
    train,
)

app = typer.Typer(
    name="tandem",
    help="A robot arm, a learning policy and a person, driving together. Start with: ./tandem train peg",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        print(__version__)
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", help="Print the version.", callback=_version, is_eager=True
    ),
) -> None:
    pass


app.command("train")(train.train)
app.command("eval")(evaluate.evaluate)
app.command("demo")(demo.demo)
app.command("diagnose")(diagnose.diagnose)
app.command("test", context_settings={"allow_extra_args": True, "ignore_unknown_options": True})(test.test)
app.add_typer(bench.app, name="bench")
app.command("table")(table.table)
app.command("ablate")(ablate.ablate)
app.command("replay")(replay.replay)
app.command("export")(export.export)
app.command("import")(import_.import_)
app.command("spy")(spy.spy)
app.command("report")(report.report)
app.command("teleop")(teleop.teleop)
app.add_typer(command.app, name="command")
app.add_typer(policy.app, name="policy")
app.command("doctor")(doctor.doctor)
app.add_typer(log.app, name="log")


def main() -> None:
    try:
        app(prog_name="tandem")
    finally:
        flush()


def flush() -> None:
    """Whoever listened may be gone (a closed terminal, a pipe): what is left goes nowhere, our exit code stays.

    Python would end with 120 instead, depending on whether anything was left to write.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
