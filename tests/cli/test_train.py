"""The supervisor with stand-ins for its programs: a whole run, deaths, Ctrl-C, resuming."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from tandem import supervisor
from tandem.run_folder import RunFolder
from tandem.scenario import compose, load

DRIVER = """
import sys
from pathlib import Path
from rich.console import Console
from tandem import scenario, supervisor
from tandem.run_folder import RunFolder
composed = scenario.compose(Path(sys.argv[1]), "peg", "tandem", {}, ["run.env_steps=10000"])
settings = supervisor.Settings(RunFolder(Path(sys.argv[2])), composed, "./tandem train peg")
sys.exit(supervisor.train(settings, Console()))
"""


def settings(config: Path, run: Path, *overrides: str, fresh: bool = False) -> supervisor.Settings:
    scenario = compose(config, "peg", "tandem", {}, overrides)
    return supervisor.Settings(RunFolder(run), scenario, "./tandem train peg", fresh=fresh)


def train(config: Path, run: Path, *overrides: str, fresh: bool = False) -> int:
    return supervisor.train(settings(config, run, *overrides, fresh=fresh), Console())


def alive(folder: Path) -> list[str]:
    """Command lines of living processes that name this folder."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = entry.read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if str(folder) in line and "fakes" in line:
            found.append(line)
    return found


def wait_for(condition: Any, process: subprocess.Popen[str] | None = None) -> None:
    deadline = time.monotonic() + 20.0
    while not condition():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.05)


def test_whole_run_leaves_every_file_and_the_agreed_names(
    config: Path, programs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    run = tmp_path / "run"
    monkeypatch.setenv("FAKE_WITHOUT_MOTION", "2")
    assert train(config, run) == 0, capsys.readouterr().err
    assert capsys.readouterr().out.count("motion is recorded no more") == 1
    for name in (
        "scenario.yaml",
        "log.lcm",
        "policy.safetensors",
        "summary.json",
        "report.html",
        "tensorboard",
        "curve.png",
        "demo.mp4",
        "controller.out",
    ):
        assert (run / name).exists(), name
    summary = json.loads((run / "summary.json").read_text())
    assert {"task", "method", "seed", "env_steps", "robot_time_s", "updates", "wall_s", "curve"} <= set(
        summary
    )
    assert {"fresh", "operator", "policy", "interventions", "throughput"} <= set(summary)
    assert {"env_steps", "updates", "wall_s", "success", "episodes"} <= set(summary["curve"][0])
    assert [point["env_steps"] for point in summary["curve"]] == [20, 40, 60]
    for which in ("selected", "last"):
        assert {"env_steps", "success", "episodes", "wilson"} <= set(summary["fresh"][which])
        assert summary["fresh"][which]["episodes"] == 12
    assert {"success", "steps_mean"} <= set(summary["operator"])
    assert summary["policy"]["steps_mean"] == 10
    assert summary["interventions"]["share"] == pytest.approx(0.3)
    assert summary["interventions"]["takeovers"] == 6  # training episodes only, each counted once
    assert {"env_steps_per_s", "updates_per_s"} <= set(summary["throughput"])
    assert summary["env_steps"] == 60 and summary["robot_time_s"] == 6.0
    assert alive(tmp_path) == []

    # The same command has nothing left to do; another scenario is refused.
    capsys.readouterr()
    assert train(config, run) == 0
    assert "is finished" in capsys.readouterr().out
    # How much the log may take is no part of what the run is: with more room it goes on.
    assert train(config, run, "run.log_quota_mb=100") == 0
    assert load(run / "scenario.yaml").run["log_quota_mb"] == 100
    assert train(config, run, "controller.clip=0.5") == 2
    assert "controller.clip is 0.5 here and 0.01 there" in capsys.readouterr().err.replace("\n", " ")


def test_fresh_keeps_the_old_run_under_another_name(config: Path, programs: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / "scenario.yaml").write_text("run: {}\n")
    (run / "precious").write_text("data")
    supervisor.open_run(settings(config, run, fresh=True), Console())
    assert (tmp_path / "run.old-1" / "precious").read_text() == "data"
    assert (run / "scenario.yaml").exists() and not (run / "precious").exists()


@pytest.mark.parametrize(
    ("variable", "value", "said"),
    [
        ("FAKE_LEARNER", "die", r"The learner was killed by SIGKILL\. Its last lines:.*out of memory"),
        ("FAKE_OPERATOR", "die", r"The operator ended with exit code 7\. Its last lines:.*has had enough"),
        (
            "FAKE_CONTROLLER",
            "fault",
            r"The controller ended with exit code 3\. Its last lines:.*joint 4 left its range",
        ),
    ],
)
def test_a_dying_program_is_named_and_takes_the_others_along_in_order(
    config: Path,
    programs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    variable: str,
    value: str,
    said: str,
) -> None:
    monkeypatch.setenv(variable, value)
    assert train(config, tmp_path / "run", "run.env_steps=10000") == 1
    assert re.search(said, capsys.readouterr().err, re.DOTALL)
    assert alive(tmp_path) == []
    if variable != "FAKE_CONTROLLER":
        assert "stopped in order" in (tmp_path / "run" / "controller.out").read_text()


def test_a_bad_scenario_is_refused_with_its_true_origin_before_anything_starts(
    config: Path, programs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task = config / "tasks" / "peg.yaml"
    task.write_text(task.read_text().replace("policy_rate_hz: 10", "policy_rate_hz: 0"))
    assert train(config, tmp_path / "run") == 2
    assert "tandem: config/tasks/peg.yaml:3: task.policy_rate_hz is 0" in capsys.readouterr().err
    assert not (tmp_path / "run" / "controller.out").exists()


def start(config: Path, run: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", DRIVER, str(config), str(run)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_ctrl_c_ends_in_order_and_the_same_command_resumes(
    config: Path, programs: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    for attempt in (1, 2):
        before = len(list((run / "checkpoints").glob("*")))
        process = start(config, run)
        wait_for(lambda n=before: len(list((run / "checkpoints").glob("*"))) >= n + 2, process)
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=20)
        assert process.returncode == 130, error
        assert "To go on:\n  ./tandem train peg" in out
        assert (run / "controller.out").read_text().count("stopped in order") == attempt
        assert "learner saved" in (run / "learner.out").read_text()
        assert alive(tmp_path) == []
    assert json.loads((run / "clock.json").read_text())["resumed"] == 1


def test_nothing_survives_a_killed_supervisor(config: Path, programs: Path, tmp_path: Path) -> None:
    process = start(config, tmp_path / "run")
    wait_for(lambda: (tmp_path / "run" / "progress.csv").exists(), process)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    wait_for(lambda: alive(tmp_path) == [])


def test_a_second_supervisor_is_kept_out(
    config: Path, programs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with RunFolder(tmp_path / "run").lock():
        assert train(config, tmp_path / "run") == 1
    assert "is in use by another call" in capsys.readouterr().err.replace("\n", " ")
