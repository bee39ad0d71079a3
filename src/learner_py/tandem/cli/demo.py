"""`tandem demo [POLICY]`."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import SetOption, find_policy, scenario_of, sentences


def demo(
    policy: Annotated[
        Path | None, typer.Argument(help="Policy file or run folder [default: the newest run below runs/].")
    ] = None,
    episodes: Annotated[int, typer.Option(help="Episodes to show.", min=1, max=100)] = 3,
    seed: Annotated[int, typer.Option(help="Which episodes, 0 to 999999.", min=0, max=999_999)] = 0,
    out: Annotated[Path, typer.Option(help="Video file.")] = Path("demo.mp4"),
    overrides: SetOption = None,
) -> None:
    """Show a trained policy: a few episodes alone and noise-free, drawn to a video. Needs no screen."""
    from rich.console import Console

    from tandem import evaluation, video
    from tandem.cli.evaluate import show

    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-demo-") as folder:
        file = find_policy(policy)
        console = Console(stderr=True)
        with console.status(f"{episodes} episodes of {file}, then the video ..."):
            value = video.of_policy(
                file,
                scenario_of(file, overrides or []),
                evaluation.DEMO_SEED + seed,
                episodes,
                Path(folder) / "demo",
                out.absolute(),
            )
    show(str(file), value)
    print(f"Video: {out}")
