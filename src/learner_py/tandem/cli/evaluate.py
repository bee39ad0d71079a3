"""`tandem eval POLICY|operator`."""

import contextlib
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, SetOption, find_policy, scenario_of, sentences, write_json


def evaluate(
    what: Annotated[
        str,
        typer.Argument(metavar="POLICY|operator", help="Policy file or run folder, or the word operator."),
    ],
    episodes: Annotated[int, typer.Option(help="Episodes.", min=1, max=10_000)] = 200,
    seed: Annotated[
        int, typer.Option(help="Which fresh seeds; never those of training, 0 to 999999.", min=0, max=999_999)
    ] = 0,
    task: Annotated[str, typer.Option(help="Task, for operator only.")] = "peg",
    overrides: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Evaluate a policy alone, noise-free, or the scripted operator alone, on seeds that training never uses.

    Prints success with its 95 % Wilson interval, steps (0.1 s each) and contact force (N).
    """
    from rich.console import Console

    from tandem import evaluation, run_folder, scenario

    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-eval-") as folder:
        if what == "operator":
            policy = None
            setting = scenario.compose(run_folder.CONFIG, task, "tandem", {}, overrides or [])
            base = evaluation.OPERATOR_SEED
        else:
            policy = find_policy(Path(what))
            setting = scenario_of(policy, overrides or [])
            base = evaluation.FRESH_SEED
        job = evaluation.Evaluation(
            name=f"evaluation of {what}",
            scenario=setting,
            policy=policy,
            seed=base + seed,
            episodes=episodes,
            folder=Path(folder) / "evaluation",
        )
        console = Console(stderr=True)
        with (
            console.status(f"{episodes} episodes of {what} ...")
            if console.is_terminal
            else contextlib.nullcontext()
        ):
            value = job.run()
    show(what, value)
    write_json(json_file, value)


def show(what: str, value: dict[str, Any]) -> None:
    """The figures for people."""
    from tandem.statistics import percent

    force = value["force"]
    steps = value["steps_mean"]
    print(f"{what}: success {percent(value['successes'], value['episodes'])}")
    print(f"  steps to success  {'-' if steps is None else f'{steps:.1f}'} (mean)")
    print(f"  peak force        {force['peak_mean']:.1f} N mean, {force['peak_max']:.1f} N max per episode")
    if value["env_steps_per_s"]:
        print(f"  speed             {value['env_steps_per_s']:.0f} env steps/s")
