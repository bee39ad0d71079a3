"""What finished runs show: sustained success, the paper's conventions, curves over seeds, the report's files."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tandem.cli.app import app
from tandem.experiments import figures
from tandem.experiments.pictures import band, win_points
from tandem.experiments.runs import Run
from tandem.run_folder import RunFolder
from tandem.summary import PROGRESS_COLUMNS, read_progress


def curve(*successes: float) -> list[dict[str, Any]]:
    return [
        {"env_steps": 1000 * i, "updates": 4000 * i, "wall_s": 30.0 * i, "success": success, "episodes": 50}
        for i, success in enumerate(successes, 1)
    ]


def put(folder: Path, method: str, seed: int, successes: int, *of_checkpoints: float) -> Run:
    """A finished run's summary and progress."""
    run = Run(method, "peg", method, seed, RunFolder(folder / f"peg-{method}-seed{seed}"))
    selected = {"success": successes / 200, "successes": successes, "episodes": 200, "env_steps": 4000}
    force = {"peak_mean": 40.0 + 20.0 * seed, "filtered_peak_mean": 10.0}
    last = selected | {"steps_mean": 30.0, "force": force}
    summary = {
        "method": method, "seed": seed, "env_steps": 4000, "robot_time_s": 400.0, "updates": 16000,
        "fresh": {"selected": selected, "last": last}, "curve": curve(*of_checkpoints), "wall_s": 120.0 + 60.0 * seed,
        "policy": {"steps_mean": 99.0, "force": {"peak_mean": 99.0, "filtered_peak_mean": 99.0}},  # the selected one's
        "operator": {"steps_mean": 20.0, "force": {"peak_mean": 70.0}},
        "interventions": {"share": 0.1, "share_first_tenth": 0.3, "share_last_tenth": 0.02},
    }  # fmt: skip
    run.folder.path.mkdir(parents=True)
    run.folder.summary.write_text(json.dumps(summary))
    with run.folder.progress.open("w", newline="") as file:
        writer = csv.DictWriter(file, PROGRESS_COLUMNS, restval=0)
        writer.writeheader()
        for steps, human, autonomous in (
            (0, 0.2, 0.4),
            (1000, 0.4, 0.5),
            (1000, 0.6, 0.5),
            (2000, "nan", 0.9),
        ):
            writer.writerow(
                {"env_steps": steps, "win_share_human": human, "win_share_autonomous": autonomous}
            )
    return run


@pytest.mark.parametrize(
    ("successes", "env_steps"),
    [
        ((0.5, 0.96, 0.98, 0.95, 0.2), 2000),  # three in a row; what comes later does not undo it
        ((0.96, 0.94, 0.96, 0.96, 0.96), 3000),  # a lucky checkpoint alone does not count
        ((0.96, 0.96, 0.94), None),
        ((0.5, 0.9, 0.96, 0.96), 3000),  # to the end
        ((0.5, 0.9, 0.94, 0.95), 4000),
        ((0.9, 0.94), None),
        ((), None),
    ],
)
def test_success_is_sustained_for_three_checkpoints_or_to_the_end(
    successes: tuple[float, ...], env_steps: int | None
) -> None:
    assert figures.sustained(curve(*successes)) == env_steps


def test_the_papers_conventions_take_the_best_checkpoint_and_start_the_clock_at_the_first(
    tmp_path: Path,
) -> None:
    runs = [put(tmp_path, "mcbc", 0, 190, 0.4, 0.9, 1.0, 1.0), put(tmp_path, "mcbc", 1, 190, 0.96, 0.5)]
    row = figures.paper_row("mcbc", figures.collect(runs)["mcbc"])
    assert row["success"] == [1.0, 0.96]
    assert row["env_steps"] == [3000, 1000]
    assert row["training_steps"] == [12000, 4000]
    assert row["time_s"] == [60.0, 0.0]
    run = put(tmp_path, "hil_serl", 0, 190, 0.4, 0.9)
    assert figures.paper_row("hil_serl", figures.collect([run])["hil_serl"])["time_s"] == [60.0]


def test_a_band_begins_where_all_have_begun_and_keeps_the_last_value_of_who_ends_earlier() -> None:
    x, mean, low, high = band([[(1, 0.0), (3, 1.0)], [(2, 0.5), (5, 0.5)]])
    assert x == [2, 3, 5]
    assert low == [0.5, 0.5, 0.5] and high == [0.5, 1.0, 1.0]
    assert mean == [0.5, 0.75, 0.75]


def test_win_shares_are_averaged_at_a_step_and_leave_out_empty_reports_and_the_warm_start(
    tmp_path: Path,
) -> None:
    run = put(tmp_path, "mcbc", 0, 190, 0.9)
    result = figures.Result(run, {}, read_progress(run.folder.progress))
    assert win_points(result, "win_share_human") == [(1000.0, 0.5)]
    assert win_points(result, "win_share_autonomous") == [(1000.0, 0.5), (2000.0, 0.9)]


def test_the_reports_files_hold_the_runs_figures(tmp_path: Path) -> None:
    put(tmp_path / "runs", "mcbc", 0, 200, 0.5, 0.96, 0.96, 0.96)
    put(tmp_path / "runs", "mcbc", 1, 194, 0.5, 0.9, 0.9, 0.9)
    put(tmp_path / "runs", "tandem", 0, 196, 1.0, 1.0, 1.0)
    arguments = ["table", "peg", "--runs", str(tmp_path / "runs"), "--collect-only", "--paper"]
    arguments += ["--report", str(tmp_path / "report"), "--json", str(tmp_path / "t.json")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output

    with (tmp_path / "report" / "report.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [(line["method"], line["seed"]) for line in lines] == [
        ("mcbc", "0"),
        ("mcbc", "1"),
        ("tandem", "0"),
    ]
    assert [line["selected_successes"] for line in lines] == ["200", "194", "196"]
    assert [line["sustained_env_steps"] for line in lines] == ["2000", "", "1000"]
    assert [float(line["force_peak_N"]) for line in lines] == [40.0, 60.0, 40.0]
    assert [float(line["wall_s"]) for line in lines] == [120.0, 180.0, 120.0]

    text = (tmp_path / "report" / "report.md").read_text()
    assert text.startswith("# Task peg\n")
    assert (
        "| mcbc | 2 | 98.5 % [96.8, 99.3] (394/400) | 100.0, 97.0 | 98.5 % [96.8, 99.3] (394/400) | 2000, - | 4000"
        " | 6.7 min | 2.5 min | 16000 | 10.0 % (30 → 2) | 30.0 (20.0) | 50.0 N (10.0) |"
    ) in text
    assert "| mcbc | 93.0 % | 96, 90 | 2000 | 8000 | 0.008 h |" in text
    for picture in ("curves.png", "last.png", "win_shares.png"):
        assert f"]({picture})" in text
        assert (tmp_path / "report" / picture).read_bytes().startswith(b"\x89PNG")

    value = json.loads((tmp_path / "t.json").read_text())
    assert value["rows"][0]["sustained_env_steps"] == [2000, None]
    assert value["rows"][0]["human_share_last_tenth"] == 0.02
    assert value["paper"][0]["success"] == [0.96, 0.9]


def test_methods_that_compare_nothing_have_no_win_shares(tmp_path: Path) -> None:
    run = put(tmp_path / "runs", "bc", 0, 20, 0.1)
    run.folder.progress.unlink()
    arguments = ["table", "peg", "--runs", str(tmp_path / "runs"), "--collect-only"]
    result = CliRunner().invoke(app, [*arguments, "--report", str(tmp_path / "report")])
    assert result.exit_code == 0, result.output
    assert not (tmp_path / "report" / "win_shares.png").exists()
    assert "win_shares" not in (tmp_path / "report" / "report.md").read_text()


def test_an_ablation_is_reported_by_the_same_code_under_its_question(tmp_path: Path) -> None:
    source = put(tmp_path / "made", "tandem", 0, 196, 1.0, 1.0, 1.0)
    for label in ("cut", "as_logged"):
        (tmp_path / f"{label}-seed0").mkdir()
        (tmp_path / f"{label}-seed0" / "summary.json").write_text(source.folder.summary.read_text())
    arguments = [
        "ablate",
        "cut",
        "--runs",
        str(tmp_path),
        "--collect-only",
        "--report",
        str(tmp_path / "report"),
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    text = (tmp_path / "report" / "report.md").read_text()
    assert text.startswith("# Does it help to count a rescue as the failure")
    assert "| variant | seeds | selected |" in text
    assert "| cut | 1 | 98.0 % " in text and "| as_logged | 1 | 98.0 % " in text
    assert "- **as_logged**: method `tandem` with `run.video_episodes=0`, `method.learner.critic.cut_" in text
