"""`tandem log ...`: event logs of runs (standard LCM logs), one command a file."""

import typer

from tandem.cli.log import compare, info, stats

app = typer.Typer(help="Look into event logs (RUN/log.lcm).", no_args_is_help=True)

app.command("info")(info.info)
app.command("stats")(stats.stats)
app.command("compare")(compare.compare)
