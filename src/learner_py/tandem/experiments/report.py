"""The report of an experiment: report.md, report.csv, and the pictures curves.png, last.png, win_shares.png."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tandem.experiments import figures, pictures
from tandem.experiments.figures import Result
from tandem.run_folder import git_revision, host, shown


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
            f"{self.title}: success on fresh seeds, pooled over training seeds, with 95 % Wilson intervals;"
            " steps and forces are the last checkpoint's.",
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
        written = [folder / name for name in ("report.md", "report.csv", "curves.png", "last.png")]
        pictures.draw_curves(folder / "curves.png", self.title, self.results)
        pictures.draw_last(folder / "last.png", self.title, self.rows, self.results)
        shown_pictures = [
            "![Success against env steps, robot time and wall time](curves.png)",
            "",
            CURVES_SENTENCE,
            "",
            "![Success, the human's share, steps and peak force of the last policies](last.png)",
            "",
            LAST_SENTENCE,
        ]
        if pictures.draw_win_shares(folder / "win_shares.png", self.title, self.results):
            written.append(folder / "win_shares.png")
            shown_pictures += ["", "![Win shares](win_shares.png)", "", WINS_SENTENCE]
        heading = [f"# {self.question or self.title}", ""]
        machine = host()
        made = f"Revision {git_revision()}; {machine['cpu']}, {machine['cores']} cores."
        parts = [*heading, self.markdown(), *shown_pictures, "", *self._runs(), "", made]
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
    "operator_force_peak_N",
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
LAST_SENTENCE = (
    "The last checkpoint's policy on fresh seeds, a dot a label, a stroke each training seed: success with its Wilson"
    " interval; the human's share of the training steps, from the first tenth (ring) to the last (dot); steps to"
    " success and peak force beside the operator's own (dashed)."
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
