"""The report of an experiment: report.md, report.csv, curves.png, win_shares.png."""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tandem.experiments import figures
from tandem.experiments.figures import Result
from tandem.run_folder import git_revision, host, shown

Points = Sequence[tuple[float, float]]  # (x, y), ascending in x


@dataclass
class Report:
    """title: what is compared; kind: what a row is (method, variant); results: by label."""

    title: str
    kind: str
    results: Mapping[str, list[Result]]
    question: str = ""
    with_paper: bool = False
    rows: list[dict[str, Any]] = field(init=False)
    paper_rows: list[dict[str, Any]] = field(init=False)

    def __post_init__(self) -> None:
        self.rows = [figures.row(label, results) for label, results in self.results.items()]
        self.paper_rows = []
        if self.with_paper:
            self.paper_rows = [figures.paper_row(label, results) for label, results in self.results.items()]

    # ---- tables

    def markdown(self) -> str:
        """The tables, with a sentence on what each holds."""
        text = [
            f"{self.title}: success on fresh seeds, pooled over training seeds, with 95 % Wilson intervals.",
            SUSTAINED_SENTENCE,
            "",
            *_markdown([self.kind, *figures.HEAD], [figures.cells(row) for row in self.rows]),
        ]
        if self.paper_rows:
            text += [
                "",
                PAPER_SENTENCE,
                "",
                *_markdown(
                    [self.kind, *figures.PAPER_HEAD], [figures.paper_cells(row) for row in self.paper_rows]
                ),
            ]
        return "\n".join(text) + "\n"

    def tables(self) -> list[Any]:
        """The same for a terminal, the wide one in two."""
        from rich.table import Table

        lines = [figures.cells(row) for row in self.rows]
        split = figures.ABOUT_SUCCESS
        parts = [
            (
                f"{self.title}: success on fresh seeds, 95 % Wilson intervals",
                figures.HEAD[:split],
                [line[: 1 + split] for line in lines],
            ),
            (
                "Means over training seeds",
                figures.HEAD[split:],
                [[line[0], *line[1 + split :]] for line in lines],
            ),
        ]
        if self.paper_rows:
            paper_cells = [figures.paper_cells(row) for row in self.paper_rows]
            parts.append((PAPER_SENTENCE, figures.PAPER_HEAD, paper_cells))
        found = []
        for title, head, body in parts:
            table = Table(title=title, title_justify="left")
            table.add_column(self.kind, no_wrap=True)
            for name in head:
                table.add_column(name, overflow="fold")
            for line in body:
                table.add_row(*line)
            found.append(table)
        return found

    # ---- files

    def write(self, folder: Path) -> list[Path]:
        """Writes all files into `folder`. Returns them."""
        folder.mkdir(parents=True, exist_ok=True)
        written = [folder / "report.md", folder / "report.csv", folder / "curves.png"]
        draw_curves(written[2], self.title, self.results)
        pictures = ["![Success against env steps, robot time and wall time](curves.png)", "", CURVES_SENTENCE]
        if draw_win_shares(folder / "win_shares.png", self.title, self.results):
            written.append(folder / "win_shares.png")
            pictures += ["", "![Win shares](win_shares.png)", "", WINS_SENTENCE]
        heading = [f"# {self.question or self.title}", ""]
        machine = host()
        made = f"Revision {git_revision()}; {machine['cpu']}, {machine['cores']} cores."
        parts = [*heading, self.markdown(), *pictures, "", *self._runs(), "", made]
        (folder / "report.md").write_text("\n".join(parts) + "\n", encoding="utf-8")
        self._write_csv(folder / "report.csv")
        return written

    def _runs(self) -> list[str]:
        """What each label is, and where its runs lie."""
        lines = ["The runs:", ""]
        for label, results in self.results.items():
            run = results[0].run
            changes = ", ".join(f"`{setting.assignment}`" for setting in run.settings)
            folders = ", ".join(shown(result.run.folder.path) for result in results)
            lines.append(
                f"- **{label}**: method `{run.method}`{f' with {changes}' if changes else ''}; {folders}"
            )
        return lines

    def _write_csv(self, path: Path) -> None:
        """One line a run; units in the names, empty where a summary lacks the figure."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([self.kind, "seed", *CSV_COLUMNS])
            for label, results in self.results.items():
                for result in results:
                    row = figures.row(label, [result])
                    fresh = {
                        f"{which}_{key}": row[which][key]
                        for which in ("selected", "last")
                        for key in ("success", "successes", "episodes")
                    }
                    flat = row | fresh | {"sustained_env_steps": row["sustained_env_steps"][0]}
                    writer.writerow([label, result.summary["seed"], *(flat[name] for name in CSV_COLUMNS)])


CSV_COLUMNS = (
    "selected_success",
    "selected_successes",
    "selected_episodes",
    "last_success",
    "last_successes",
    "last_episodes",
    "sustained_env_steps",
    "env_steps",
    "robot_time_s",
    "wall_s",
    "updates",
    "human_share",
    "human_share_first_tenth",
    "human_share_last_tenth",
    "steps_mean",
    "operator_steps_mean",
    "force_peak_N",
    "force_filtered_peak_N",
)
SUSTAINED_SENTENCE = (
    "`≥ 95 % from step`, by seed: env steps of the first checkpoint from which success stays at 95 % or more for three"
    " checkpoints, or to the end."
)
PAPER_SENTENCE = (
    "By the paper's conventions: the best checkpoint's own episodes (which picked it), training steps = gradient"
    " updates, time from the first checkpoint on (HIL-SERL: from the start); means over seeds."
)
CURVES_SENTENCE = (
    "Success of every checkpoint on the same seeds: mean over training seeds, band from the worst to the best of them."
    " All clocks start with the first training step; demonstrations and warm start are apart."
)
WINS_SENTENCE = (
    "Share of a minibatch's rows in which the policy's own chunk scores at least as high as the logged one, by who"
    " drove in the logged one: mean over training seeds, band from the lowest to the highest. Methods that compare"
    " nothing are left out."
)


def _markdown(head: Sequence[str], lines: Sequence[Sequence[str]]) -> list[str]:
    return [
        "| " + " | ".join(head) + " |",
        "|" + "---|" * len(head),
        *("| " + " | ".join(line) + " |" for line in lines),
    ]


# ---- pictures


def band(series: Sequence[Points], n: int = 200) -> tuple[list[float], list[float], list[float], list[float]]:
    """x, mean, lowest and highest of several curves whose x differ; straight lines between their points.

    From where all have begun to where the last one ends; one that ends earlier keeps its last value, because its policy
    stays what it is.
    """
    import numpy as np

    columns = [tuple(np.asarray(points, float).T) for points in series]
    start, end = max(x[0] for x, _ in columns), max(x[-1] for x, _ in columns)
    own = {value for x, _ in columns for value in x if start <= value <= end}
    grid = np.array(sorted(own)) if len(own) <= n else np.linspace(start, end, n)
    values = np.stack([np.interp(grid, x, y) for x, y in columns])
    return (
        grid.tolist(),
        values.mean(axis=0).tolist(),
        values.min(axis=0).tolist(),
        values.max(axis=0).tolist(),
    )


def success_points(result: Result, clock: str) -> Points:
    """Success of a run's checkpoints against env_steps, robot_time_s or wall_s."""
    summary = result.summary
    step_s = summary["robot_time_s"] / summary["env_steps"] if summary["env_steps"] else math.nan
    points = []
    for point in summary.get("curve", []):
        x = point["env_steps"] * step_s if clock == "robot_time_s" else point[clock]
        if x is not None and math.isfinite(x):
            points.append((float(x), float(point["success"])))
    return sorted(points)


def win_points(result: Result, column: str) -> Points:
    """A win share against env steps; reports of the same step are averaged, empty ones left out.

    Before the first training step there is none: the warm start imitates without comparing.
    """
    at: dict[float, list[float]] = {}
    for row in result.progress:
        if row["env_steps"] > 0 and math.isfinite(row[column]):
            at.setdefault(row["env_steps"], []).append(row[column])
    return [(steps, sum(values) / len(values)) for steps, values in sorted(at.items())]


def draw_curves(path: Path, title: str, results: Mapping[str, list[Result]]) -> None:
    panels = [
        ("env_steps", "env steps", 1.0),
        ("robot_time_s", "robot time, min", 60.0),
        ("wall_s", "wall time of training, min", 60.0),
    ]
    series = [
        (name, {label: [success_points(r, clock) for r in runs] for label, runs in results.items()}, unit)
        for clock, name, unit in panels
    ]
    _draw(path, title, "success of the policy alone", series)


def draw_win_shares(path: Path, title: str, results: Mapping[str, list[Result]]) -> bool:
    """False, and no picture, when no method compares chunks."""
    panels = [
        ("win_share_human", "env steps; logged chunks that a human drove"),
        ("win_share_autonomous", "env steps; logged chunks that the policy drove"),
    ]
    comparing = {
        label: runs
        for label, runs in results.items()
        if any(win_points(run, column) for run in runs for column, _ in panels)
    }
    if not comparing:
        return False
    series = [
        (name, {label: [win_points(r, column) for r in runs] for label, runs in comparing.items()}, 1.0)
        for column, name in panels
    ]
    _draw(path, title, "share of wins of the policy's chunk", series)
    return True


def _draw(
    path: Path, title: str, y_name: str, panels: Sequence[tuple[str, Mapping[str, list[Points]], float]]
) -> None:
    """One panel an x axis (name, curves by label, divisor of x), one colour a label."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        1, len(panels), sharey=True, squeeze=False, figsize=(5 * len(panels), 4.5), layout="constrained"
    )
    for axis, (x_name, curves, unit) in zip(axes[0], panels, strict=True):
        colours = plt.get_cmap("tab10" if len(curves) <= 10 else "tab20")
        for number, (label, runs) in enumerate(curves.items()):
            if not (series := [points for points in runs if points]):
                continue
            x, mean, low, high = band(series)
            x = [value / unit for value in x]
            colour = colours(number % colours.N)
            axis.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
            axis.plot(x, mean, color=colour, marker="." if len(x) < 40 else None, label=label)
        axis.set(xlabel=x_name, ylim=(-0.02, 1.02))
        axis.grid(alpha=0.3)
    axes[0][0].set(ylabel=y_name)
    if axes[0][0].get_legend_handles_labels()[0]:
        axes[0][0].legend(fontsize="small")
    figure.suptitle(title)
    figure.savefig(path, dpi=120)
    plt.close(figure)
