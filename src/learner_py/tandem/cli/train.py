"""`tandem train TASK`."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import SetOption, fail, same_command, sentences
from tandem.cli.log import find


class Clock(StrEnum):
    lockstep = "lockstep"
    realtime = "realtime"


class Operator(StrEnum):
    scripted = "scripted"
    keyboard = "keyboard"
    gamepad = "gamepad"
    none = "none"


class Observe(StrEnum):
    state = "state"
    image = "image"


PERSONS = (Operator.keyboard, Operator.gamepad)


def train(
    task: Annotated[str, typer.Argument(help="Task: a file of config/tasks, e.g. peg.")],
    method: Annotated[
        str | None,
        typer.Option(help="Method: a file of config/methods [default: tandem; with --from that of the log]."),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            help="Seed of everything random, 0 to 999999 [default: 0; with --from that of the log]."
        ),
    ] = None,
    run: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Run folder [default: runs/TASK-METHOD-seedSEED, with images runs/TASK-METHOD-image-seedSEED].",
        ),
    ] = None,
    clock: Annotated[
        Clock,
        typer.Option(
            help="lockstep: simulated time, deterministic, as fast as it goes; realtime: 1 kHz wall clock."
        ),
    ] = Clock.lockstep,
    observe: Annotated[
        Observe | None,
        typer.Option(
            help="What the policy sees. state: the task's observation, poses included; image: what the arm knows by"
            " itself, and its wrist cameras [default: state]."
        ),
    ] = None,
    operator: Annotated[
        Operator,
        typer.Option(
            help="scripted: a stand-in for a person; keyboard, gamepad: you, in real time (see ./tandem teleop);"
            " none: your own program answers WORLD_STATE."
        ),
    ] = Operator.scripted,
    demonstrations: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG",
            help="Begin with the successful demonstrations of this log (see ./tandem import); the operator adds what"
            " run.demonstrations asks for beyond them.",
        ),
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="LOG",
            help="Without an arm: rebuild the buffer from this log (or run), do the updates of its episodes, write the"
            " policy to --run [default: runs/TASK-METHOD-seedSEED-offline].",
        ),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Start anew; the old folder is kept as DIR.old-N.")
    ] = False,
    overrides: SetOption = None,
    lcm_url: Annotated[
        str | None,
        typer.Option(
            help="LCM address of the run [default: LCM_DEFAULT_URL, else a free port on this machine]."
        ),
    ] = None,
) -> None:
    """Train a policy: demonstrations, training beside the operator, evaluation, curve, video.

    Ends with a table and RUN/summary.json. Ctrl-C stops in good order; the same command goes on where it
    stopped. How long it trains: --set run.env_steps=N (0.1 s of robot time each, default in config/run.yaml).
    """
    from rich.console import Console

    from tandem import run_folder, scenario, supervisor

    if source is not None:
        from tandem.cli.train_from import train_from

        if observe is not None:
            fail("--observe is what the log was recorded with; leave it out with --from.", 2)
        return train_from(task, source, method, seed, run, fresh, overrides or [])
    method, seed = method or "tandem", seed or 0
    with sentences():
        values: dict[str, Any] = {"mode": "train", "seed": seed, "clock": clock.value}
        if observe is not None:
            values["observe"] = observe.value
        if demonstrations is not None:
            from tandem.demonstrations import count

            demonstrations = find(demonstrations)
            values["demonstrations"] = count(demonstrations)
        composed = scenario.compose(run_folder.CONFIG, task, method, values, overrides or [])
        if operator in PERSONS and composed.run["clock"] != "realtime":
            fail(
                f"--operator {operator.value} needs --clock realtime: in lockstep the arm waits for an answer to each"
                " step, and time does not pass as it does for you.",
                2,
            )
        if operator in PERSONS and not (sys.stdin.isatty() and sys.stdout.isatty()):
            fail(f"--operator {operator.value} needs a terminal, and stdin or stdout is none.", 2)
        sees = composed.run["observe"] == "image"
        folder = run or run_folder.default_run(
            task, f"{method}-image" if sees else method, composed.run["seed"]
        )
        settings = supervisor.Settings(
            folder=run_folder.RunFolder(folder.absolute()),
            scenario=composed,
            resume_command=same_command(),
            lcm_url=lcm_url,
            fresh=fresh,
            operator=operator.value,
            demonstrations=demonstrations,
        )
        code = supervisor.train(settings, Console())
    raise typer.Exit(code)
