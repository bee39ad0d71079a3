"""`train --operator keyboard`: a person's program gets the terminal and gives it back, whatever happens."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "teleop"))
from person import Person, wait_for

DRIVER = """
import sys
from pathlib import Path
from rich.console import Console
from tandem import scenario, supervisor
from tandem.cli.app import flush
from tandem.run_folder import RunFolder
overrides = ["run.clock=realtime", "run.env_steps=" + sys.argv[3]]
composed = scenario.compose(Path(sys.argv[1]), "peg", "tandem", {}, overrides)
settings = supervisor.Settings(RunFolder(Path(sys.argv[2])), composed, "./tandem train peg", operator="keyboard")
try:
    sys.exit(supervisor.train(settings, Console()))
finally:
    flush()
"""


def start(config: Path, run: Path, env_steps: int) -> Person:
    return Person([sys.executable, "-c", DRIVER, str(config), str(run), str(env_steps)])


def teleop_pids(run: Path) -> list[int]:
    """Living teleop programs of this run."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = entry.read_bytes().decode().split("\0")
        except OSError:
            continue
        if "--within-training" in words and str(run) in words:
            found.append(int(entry.parent.name))
    return found


@pytest.fixture
def person(config: Path, programs: Path, tmp_path: Path) -> Iterator[Person]:
    with start(config, tmp_path / "run", 100_000) as at_the_keys:
        at_the_keys.see("running")
        yield at_the_keys


def test_the_screen_is_the_persons_until_the_end_and_the_table_comes_after(
    config: Path, programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_EPISODE_S", "0.5")
    run = tmp_path / "run"
    with start(config, run, 60) as person:
        person.see("hands off")
        url = (run / "lcm_url").read_text().strip()
        assert url.startswith("udpm://")
        person.see("env steps")
        assert person.wait(60) == 0, person.seen[-3000:]
        assert person.restored
        after = person.seen.rpartition("\x1b[?1049l")[2]
        assert "fresh" in after and "summary.json" in after
    assert not (run / "lcm_url").exists()
    assert "Training in" in (run / "train.out").read_text()
    assert json.loads((run / "summary.json").read_text())["env_steps"] == 60


def test_ctrl_c_ends_the_whole_run_in_order(person: Person, tmp_path: Path) -> None:
    person.type(b"\x03")
    assert person.wait(30) == 130, person.seen[-2000:]
    assert person.restored
    assert "To go on:" in person.seen.rpartition("\x1b[?1049l")[2]
    assert "stopped in order" in (tmp_path / "run" / "controller.out").read_text()
    assert teleop_pids(tmp_path / "run") == []


def test_a_killed_persons_program_is_started_again(person: Person, tmp_path: Path) -> None:
    (first,) = teleop_pids(tmp_path / "run")
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: teleop_pids(tmp_path / "run") not in ([], [first]))
    assert "was killed by SIGKILL" in (tmp_path / "run" / "train.out").read_text()
    time.sleep(1.0)
    person.type(b"\x03")
    assert person.wait(30) == 130
    assert person.restored


def test_a_lost_terminal_stops_the_run_in_order(person: Person, tmp_path: Path) -> None:
    person.hang_up()
    assert person.wait(30) == 130
    assert "stopped in order" in (tmp_path / "run" / "controller.out").read_text()


def test_a_killed_supervisor_leaves_neither_programs_nor_a_raw_terminal(
    person: Person, tmp_path: Path
) -> None:
    os.kill(person.pid, signal.SIGKILL)
    person.wait()
    wait_for(lambda: teleop_pids(tmp_path / "run") == [])
    assert person.restored


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--operator", "keyboard"], "needs --clock realtime"),
        (["--operator", "gamepad"], "needs --clock realtime"),
        (["--operator", "keyboard", "--clock", "realtime"], "needs a terminal"),
    ],
)
def test_a_person_is_refused_in_lockstep_and_without_a_terminal(
    programs: Path, tmp_path: Path, options: list[str], said: str
) -> None:
    command = [sys.executable, "-m", "tandem", "train", "peg", "--run", str(tmp_path / "run"), *options]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    assert done.returncode == 2
    assert said in done.stderr
    assert not (tmp_path / "run").exists()
