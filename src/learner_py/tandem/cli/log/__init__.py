"""`tandem log ...`: event logs of runs (standard LCM logs), one command a file."""

import typer

from tandem.cli.log import check, compare, echo, edit, info, plot, spy_jar, stats, video
from tandem.cli.log.common import find

__all__ = ["app", "find"]

app = typer.Typer(help="Look into event logs (RUN/log.lcm).", no_args_is_help=True)

app.command("info")(info.info)
app.command("stats")(stats.stats)
app.command("check")(check.check)
app.command("echo")(echo.echo)
app.command("plot")(plot.plot)
app.command("video")(video.video)
app.command("cut")(edit.cut)
app.command("merge")(edit.merge)
app.command("spy-jar")(spy_jar.spy_jar)
app.command("compare")(compare.compare)
