"""The commands around training: help, table, selection, seeds."""

import itertools
import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tandem import evaluation, scenario
from tandem.cli.app import app
from tandem.cli.bench import report
from tandem.cli.doctor import round_trip
from tandem.processes import free_lcm_url

COMMANDS = [
    "train",
    "eval",
    "demo",
    "test",
    "bench",
    "bench sim",
    "bench loop",
    "bench spy",
    "bench recording",
    "spy",
    "report",
    "table",
    "ablate",
    "doctor",
    "log",
    "log info",
    "log compare",
    "policy info",
    "policy run",
    "policy convert",
]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command: str) -> None:
    result = CliRunner().invoke(app, [*command.split(), "--help"])
    assert result.exit_code == 0
    assert "Usage:" in result.output


def test_selection_takes_highest_success_then_shortest_then_latest() -> None:
    def at(env_steps: int, success: float, steps: float | None) -> dict[str, Any]:
        return {"env_steps": env_steps, "success": success, "steps_mean": steps}

    assert (
        evaluation.select([at(1, 0.9, 10), at(2, 1.0, 40), at(3, 1.0, 30), at(4, 0.8, 5)])["env_steps"] == 3
    )
    assert evaluation.select([at(1, 1.0, 30), at(2, 1.0, 30)])["env_steps"] == 2
    assert evaluation.select([at(1, 0.0, None), at(2, 0.0, None)])["env_steps"] == 2


def test_evaluation_seeds_never_meet_training_seeds_or_each_other() -> None:
    bases = [
        evaluation.CHECKPOINT_SEED,
        evaluation.FRESH_SEED,
        evaluation.OPERATOR_SEED,
        evaluation.DEMO_SEED,
    ]
    ranges = [
        (0, scenario.MAX_TRAINING_SEED),
        (bases[0], bases[0]),
        *((b, b + scenario.MAX_TRAINING_SEED) for b in bases[1:]),
    ]
    for (_, high), (low, _) in itertools.pairwise(ranges):
        assert high < low


def test_bench_sim_reports_medians_and_their_ratio() -> None:
    rounds = [
        {"env_steps_per_s": x, "gym_hil_env_steps_per_s": y} for x, y in ((300, 50), (900, 60), (360, 1))
    ]
    value = report(rounds, core=0)
    assert (value["env_steps_per_s"], value["gym_hil_env_steps_per_s"], value["ratio"]) == (360, 50, 7.2)


def test_lcm_carries_a_message_on_this_machine() -> None:
    assert round_trip(free_lcm_url()) is not None


def summary(method: str, seed: int, successes: int) -> dict[str, Any]:
    fresh = {"success": successes / 200, "successes": successes, "episodes": 200, "env_steps": 4000}
    return {
        "method": method, "seed": seed, "env_steps": 4000, "robot_time_s": 400.0, "updates": 9000,
        "fresh": {"selected": fresh, "last": fresh}, "policy": {"steps_mean": 30.0},
        "operator": {"steps_mean": None}, "interventions": {"share": 0.1}, "wall_s": 60.0,
    }  # fmt: skip


def test_table_pools_seeds_and_writes_markdown_and_json(tmp_path: Path) -> None:
    for seed, successes in ((0, 200), (1, 194)):
        file = tmp_path / f"peg-mcbc-seed{seed}" / "summary.json"
        file.parent.mkdir()
        file.write_text(json.dumps(summary("mcbc", seed, successes)))
    arguments = [
        "table",
        "peg",
        "--runs",
        str(tmp_path),
        "--collect-only",
        "--markdown",
        str(tmp_path / "t.md"),
    ]
    result = CliRunner().invoke(app, [*arguments, "--json", str(tmp_path / "t.json")])
    assert result.exit_code == 0, result.output
    row = json.loads((tmp_path / "t.json").read_text())["rows"][0]
    assert row["seeds"] == [0, 1]
    assert (row["selected"]["successes"], row["selected"]["episodes"]) == (394, 400)
    assert row["selected"]["wilson"] == pytest.approx([0.9676, 0.9931], abs=1e-4)
    assert "| mcbc | 2 | 98.5 % [96.8, 99.3] (394/400) | 100.0, 97.0 |" in (tmp_path / "t.md").read_text()


def test_unknown_policy_is_a_sentence(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["eval", str(tmp_path / "nothing")])
    assert result.exit_code == 2
    assert "does not exist; give a policy file" in result.output
