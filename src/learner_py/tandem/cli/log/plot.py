"""`tandem log plot`."""

from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import fail, sentences
from tandem.cli.log.common import LogArgument, opened


def plot(
    log: LogArgument,
    episode: Annotated[
        int | None, typer.Option(help="Draw this episode instead of the whole run.", min=0)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Picture: .png, .svg or .pdf [default: run.png, or episode_N.png, here]."),
    ] = None,
) -> None:
    """Draw a run on a page, or an episode: pose, force, torque, actions, authority, values, seams, interventions.

    Q is computed again from the policy file in force, or from the last checkpoint before it, when one is there and
    carries a critic. The run's page takes losses and evaluations from the run folder when the log lies in one.
    """
    from tandem.log import episode_page, run_page

    file = out or Path("run.png" if episode is None else f"episode_{episode}.png")
    if file.suffix not in (".png", ".svg", ".pdf"):
        fail(f"{file} must end in .png, .svg or .pdf.", 2)
    with sentences():
        event_log = opened(log)
        run = event_log.scenario.get("run", {})
        title = " · ".join(str(run[key]) for key in ("task", "method") if key in run)
        title += f" · seed {run['seed']}" if "seed" in run else event_log.path.name
        try:
            if episode is None:
                if not len(event_log.episodes):
                    fail(f"{event_log.path} holds no whole episode; there is nothing to draw.", 1)
                panels = run_page.draw(event_log, file, title)
                print(f"{file}: {', '.join(panels)}")
                return
            data = episode_page.read_episode(event_log, episode)
            episode_page.draw(data, file, title)
        except episode_page.NoEpisodeError as error:
            fail(str(error), 2)
        except OSError as error:
            fail(f"{file} can't be written ({error.strerror}).")
    if data.values is None:
        print(f"{file}: no Q, since no policy file with a critic lies beside the log for this episode")
    else:
        print(f"{file}: Q by the critic of {data.values.policy}")
