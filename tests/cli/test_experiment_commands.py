"""`tandem table` and `tandem ablate` as they are called, over `tandem train` with stand-ins for its programs."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

# One checkpoint, and episodes (below) long enough for the learner's stand-in to be there: what it misses is no file.
SHORT = [
    "run.env_steps=40", "run.evaluation_every=40", "run.demonstrations=2", "run.evaluation_episodes=10",
    "run.fresh_episodes=10", "run.video_episodes=0",
]  # fmt: skip


def start(*words: str, settings: list[str] = SHORT, episode_s: float = 0.3) -> subprocess.Popen[str]:
    overrides = [word for setting in settings for word in ("--set", setting)]
    return subprocess.Popen(
        [sys.executable, "-m", "tandem", *words, *overrides],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "FAKE_EPISODE_S": str(episode_s)},
    )


def call(*words: str, settings: list[str] = SHORT) -> tuple[int, str]:
    process = start(*words, settings=settings)
    out, _ = process.communicate(timeout=120)
    return process.returncode, out


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.05)


def files(folder: Path) -> set[str]:
    """Relative paths; TensorBoard wants time and process in the names of its files, and those are no outcome."""
    paths = (str(file.relative_to(folder)) for file in folder.rglob("*"))
    return {re.sub(r"(tfevents)\..*", r"\1", path) for path in paths}


def test_a_stopped_table_goes_on_by_the_same_command(programs: Path, tmp_path: Path) -> None:
    words = ["table", "peg", "--methods", "tandem,bc", "--seeds", "0", "--jobs", "2", "--runs", str(tmp_path)]
    slow = start(*words, episode_s=3.0)
    wait_for(lambda: all((tmp_path / f"peg-{m}-seed0" / "log.lcm").exists() for m in ("tandem", "bc")))
    wait_for(lambda: all(log.stat().st_size for log in tmp_path.glob("*/log.lcm")))
    slow.send_signal(signal.SIGINT)
    out, _ = slow.communicate(timeout=60)
    assert slow.returncode == 130, out
    assert "To go on:\n  ./tandem table peg --methods tandem,bc" in out
    for method in ("tandem", "bc"):
        run = tmp_path / f"peg-{method}-seed0"
        assert "controller stopped in order" in (run / "controller.out").read_text()
        assert not (run / "summary.json").exists()

    # Runs of another length that have begun are refused, by the training itself.
    code, out = call(*words, settings=[*SHORT, "run.env_steps=60"])
    assert code == 1, out
    assert "holds a run of another scenario: run.env_steps is 60 here and 40 there" in out
    assert "2 runs failed:" in out

    code, out = call(*words)
    assert code == 0, out
    assert "started again: tandem, seed 0" in out and "[2/2] finished: " in out and "│ bc" in out


def test_ray_leaves_the_same_folders(programs: Path, tmp_path: Path) -> None:
    words = ["table", "peg", "--methods", "tandem,bc", "--seeds", "0", "--jobs", "2"]
    for folder, ray in (("here", []), ("ray", ["--ray", "local"])):
        code, out = call(*words, "--runs", str(tmp_path / folder), *ray)
        assert code == 0, out
        assert "[2/2] finished: " in out
    assert files(tmp_path / "ray") == files(tmp_path / "here")
    for run in ("peg-tandem-seed0", "peg-bc-seed0"):
        scenario = (tmp_path / "ray" / run / "scenario.yaml").read_text()
        assert scenario == (tmp_path / "here" / run / "scenario.yaml").read_text()


def test_a_killed_ablation_goes_on_where_it_was(programs: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    words = ["ablate", "cut", "--seeds", "0", "--jobs", "1", "--runs", str(runs)]
    process = start(*words, episode_s=0.5)
    wait_for(lambda: (runs / "as_logged-seed0" / "progress.csv").exists())
    process.kill()
    process.communicate()
    first = (runs / "cut-seed0" / "summary.json").stat().st_mtime_ns
    code, out = call(*words, "--report", str(tmp_path / "report"))
    assert code == 0, out
    assert "2 runs: 1 finished before, 1 to do, 1 at a time." in out
    assert "started again: as_logged, seed 0" in out
    assert (runs / "cut-seed0" / "summary.json").stat().st_mtime_ns == first
    assert (tmp_path / "report" / "win_shares.png").exists()
    assert "| as_logged | 1 | 80.0 % " in (tmp_path / "report" / "report.md").read_text()


def test_no_run_begins_when_one_of_them_is_wrong(programs: Path, tmp_path: Path) -> None:
    runs = str(tmp_path / "runs")
    code, out = call("table", "peg", "--methods", "tandem,mcbd", "--runs", runs)
    assert code == 2
    assert "mcbd, seed 0: There is no method 'mcbd'" in out
    code, out = call("ablate", "head", "--runs", runs, settings=["method.learner.critic.kind=none"])
    assert code == 2
    assert "learner.critic.kind is none" in out
    assert not os.path.exists(runs)
