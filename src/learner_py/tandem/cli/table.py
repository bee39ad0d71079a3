"""`tandem table TASK`: methods x seeds."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, SetOption, fail, sentences, write_json


def table(
    task: Annotated[str, typer.Argument(help="Task: a file of config/tasks, e.g. peg.")],
    methods: Annotated[
        str, typer.Option(help="Methods, comma-separated [default: all that have a finished run].")
    ] = "",
    seeds: Annotated[str, typer.Option(help="Training seeds, comma-separated.")] = "0,1,2",
    runs: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the run folders [default: runs].")
    ] = None,
    collect_only: Annotated[
        bool, typer.Option("--collect-only", help="Train nothing; show the finished runs.")
    ] = False,
    markdown: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the table as Markdown to FILE.")
    ] = None,
    overrides: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Compare methods: trains what is missing, one run after another; success with Wilson intervals.

    Success is of fresh seeds, pooled over training seeds; `selected` is each run's best checkpoint, `last`
    its last one.
    """
    from rich.console import Console

    from tandem import run_folder, scenario, supervisor

    folder = (runs or run_folder.RUNS).absolute()
    with sentences():
        try:
            numbers = [int(seed) for seed in seeds.split(",")]
        except ValueError:
            fail(f"--seeds is {seeds!r}; it must be whole numbers with commas between, e.g. 0,1,2.", 2)
        wanted = [name.strip() for name in methods.split(",") if name.strip()] or _finished_methods(
            folder, task
        )
        if not wanted:
            fail(
                f"no run of {task} below {run_folder.shown(folder)} is finished; name --methods to train,"
                " e.g. --methods tandem,mcbc.",
                2,
            )
        for method in wanted:
            for seed in numbers:
                run = run_folder.RunFolder(folder / f"{task}-{method}-seed{seed}")
                if run.summary.exists() or collect_only:
                    continue
                print(f"Training {task}, {method}, seed {seed} ...", flush=True)
                composed = scenario.compose(
                    run_folder.CONFIG, task, method, {"mode": "train", "seed": seed}, overrides or []
                )
                command = f"./tandem train {task} --method {method} --seed {seed} --run {run.path}"
                if code := supervisor.train(supervisor.Settings(run, composed, command), Console()):
                    raise typer.Exit(code)
        rows = [row for method in wanted if (row := _row(folder, task, method, numbers))]
    text = as_markdown(task, rows)
    Console().print(_rich(task, rows))
    if markdown is not None:
        markdown.write_text(text, encoding="utf-8")
    write_json(json_file, {"task": task, "rows": rows})


def _finished_methods(folder: Path, task: str) -> list[str]:
    found = set()
    for file in folder.glob(f"{task}-*-seed*/summary.json"):
        found.add(file.parent.name[len(task) + 1 :].rsplit("-seed", 1)[0])
    return sorted(found)


def _row(folder: Path, task: str, method: str, seeds: list[int]) -> dict[str, Any] | None:
    """One method's figures over the seeds that are finished, None without any."""
    from tandem.statistics import mean, wilson

    summaries = []
    for seed in seeds:
        file = folder / f"{task}-{method}-seed{seed}" / "summary.json"
        if file.exists():
            summaries.append(json.loads(file.read_text()))
    if not summaries:
        return None
    row: dict[str, Any] = {"method": method, "seeds": [s["seed"] for s in summaries]}
    for which in ("selected", "last"):
        fresh = [s["fresh"][which] for s in summaries]
        successes, episodes = sum(f["successes"] for f in fresh), sum(f["episodes"] for f in fresh)
        row[which] = {
            "success": successes / episodes,
            "successes": successes,
            "episodes": episodes,
            "wilson": list(wilson(successes, episodes)),
            "by_seed": [f["success"] for f in fresh],
            "env_steps": [f["env_steps"] for f in fresh],
        }
    row["env_steps"] = mean([s["env_steps"] for s in summaries])
    row["robot_time_s"] = mean([s["robot_time_s"] for s in summaries])
    row["updates"] = mean([s["updates"] for s in summaries])
    row["wall_s"] = mean([s["wall_s"] for s in summaries])
    row["human_share"] = mean([s["interventions"]["share"] for s in summaries])
    row["steps_mean"] = mean(
        [s["policy"]["steps_mean"] for s in summaries if s["policy"]["steps_mean"] is not None]
    )
    row["operator_steps_mean"] = mean(
        [s["operator"]["steps_mean"] for s in summaries if s["operator"]["steps_mean"] is not None]
    )
    return row


_HEAD = (
    "method",
    "seeds",
    "selected",
    "by seed",
    "last",
    "env steps",
    "robot time",
    "updates",
    "human",
    "steps (operator)",
)


def _cells(row: dict[str, Any]) -> list[str]:
    from tandem.statistics import percent

    def steps(value: float | None) -> str:
        return "-" if value is None else f"{value:.1f}"

    return [
        row["method"],
        str(len(row["seeds"])),
        percent(row["selected"]["successes"], row["selected"]["episodes"]),
        ", ".join(f"{100 * s:.1f}" for s in row["selected"]["by_seed"]),
        percent(row["last"]["successes"], row["last"]["episodes"]),
        f"{row['env_steps']:.0f}",
        f"{row['robot_time_s'] / 60:.1f} min",
        f"{row['updates']:.0f}",
        f"{100 * row['human_share']:.1f} %",
        f"{steps(row['steps_mean'])} ({steps(row['operator_steps_mean'])})",
    ]


def as_markdown(task: str, rows: list[dict[str, Any]]) -> str:
    """The table, with a sentence on what it holds."""
    lines = [
        f"Task {task}: success on fresh seeds, pooled over training seeds, with 95 % Wilson intervals.",
        "",
        "| " + " | ".join(_HEAD) + " |",
        "|" + "---|" * len(_HEAD),
        *("| " + " | ".join(_cells(row)) + " |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


def _rich(task: str, rows: list[dict[str, Any]]) -> Any:
    from rich.table import Table

    shown = Table(title=f"{task}: success on fresh seeds, 95 % Wilson intervals", title_justify="left")
    for name in _HEAD:
        shown.add_column(name)
    for row in rows:
        shown.add_row(*_cells(row))
    return shown
