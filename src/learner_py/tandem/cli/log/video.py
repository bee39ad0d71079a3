"""`tandem log video`."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import fail, sentences
from tandem.cli.log.common import LogArgument, opened, selected

LONGEST = 50  # episodes in a video


def video(
    log: LogArgument,
    episodes: Annotated[
        str, typer.Option("--episodes", metavar="A-B", help="7, 3-5 (both included), 40- or -9.")
    ],
    out: Annotated[Path, typer.Option(help="Video file, .mp4.")] = Path("episodes.mp4"),
) -> None:
    """Draw episodes of a log to a video, in the log's own time. Needs no screen."""
    from rich.console import Console

    from tandem.log.edit import cut
    from tandem.video import of_log

    if out.suffix != ".mp4":
        fail(f"{out} must end in .mp4.", 2)
    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-video-") as name:
        source = opened(log)
        rows = selected(source, source.index.rows(), episodes, None, None)
        n = int(((source.episodes.last >= rows[0]) & (source.episodes.last <= rows[-1])).sum())
        if n > LONGEST:
            fail(f"--episodes {episodes} are {n} episodes; a video takes {LONGEST} at most.", 2)
        part = Path(name) / "log.lcm"
        cut(source, rows, part)
        with Console(stderr=True).status(f"drawing {n} episodes ..."):
            of_log(part, out.absolute(), n, Path(name) / "render.out")
    print(f"{out}: {n} episodes")
