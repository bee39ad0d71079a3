"""`tandem import FORMAT DATASET`: demonstrations that others recorded."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import SetOption, fail, sentences


class Format(StrEnum):
    lerobot = "lerobot"


def import_(
    kind: Annotated[Format, typer.Argument(metavar="FORMAT", help="lerobot: a LeRobotDataset v3.0.")],
    dataset: Annotated[Path, typer.Argument(help="Folder of the dataset.")],
    out: Annotated[
        Path, typer.Option(metavar="LOG", help="Event log to make, or a folder that gets log.lcm.")
    ],
    task: Annotated[str, typer.Option(help="Task of the demonstrations: a file of config/tasks.")] = "peg",
    method: Annotated[
        str, typer.Option(help="Method whose settings the log carries: a file of config/methods.")
    ] = "tandem",
    overrides: SetOption = None,
) -> None:
    """Make an event log of a dataset's successful episodes, as demonstrations.

    Then: ./tandem train peg --demonstrations LOG (they come in place of the operator's), or
    ./tandem train peg --from LOG (a policy from them alone, without an arm).
    """
    from tandem import demonstrations, lerobot_demonstrations, run_folder, scenario
    from tandem.run_folder import RunFolder, shown

    log = out if out.suffix == ".lcm" else RunFolder(out).log
    if log.exists():
        fail(f"{shown(log)} exists; give another --out, or remove it.", 2)
    with sentences():
        composed = scenario.compose(run_folder.CONFIG, task, method, {}, overrides or [])
        imported = lerobot_demonstrations.read(dataset, composed)
        composed.run["demonstrations"] = len(imported.episodes)
        try:
            demonstrations.write_log(log, composed, imported.episodes)
        except OSError as error:
            fail(f"{log} can't be written ({error.strerror}).")
    steps = sum(episode.n_steps for episode in imported.episodes)
    print(f"{shown(log)}: {len(imported.episodes)} demonstrations, {steps} steps")
    if imported.left_out:
        print(f"{imported.left_out} episodes without success were left out.")
    if not imported.tells_success:
        print(
            "The dataset does not say which episodes succeeded (next.success, next.reward); all were taken."
        )
