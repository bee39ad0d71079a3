"""The whole of Tandem with its real programs: train, watch, stop, kill, go on. Small budgets, nothing faked."""

import json
import os
import re
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tandem import processes, scenario
from tandem.log import messages
from tandem.log.compare import first_difference
from tandem.policy_file import read_header
from tandem.run_folder import CONFIG, program

ROOT = Path(__file__).parents[2]
SMALL = {
    "run.demonstrations": 3,
    "run.env_steps": 150,
    "run.evaluation_every": 100,
    "run.evaluation_episodes": 2,
    "run.fresh_episodes": 2,
    "run.video_episodes": 0,
    "method.learner.warm_start_updates": 20,
    "method.learner.updates_per_env_step": 1,
}


def command(run: Path, *options: str, **overrides: object) -> list[str]:
    values = {**SMALL, **overrides}
    sets = [word for key, value in values.items() for word in ("--set", f"{key}={value}")]
    return [sys.executable, "-m", "tandem", "train", "peg", "--run", str(run), "--seed", "5", *sets, *options]


def train(run: Path, *options: str, **overrides: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(run, *options, **overrides), capture_output=True, text=True, timeout=240, cwd=ROOT
    )


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run from nothing to its summary."""
    run = tmp_path_factory.mktemp("full_loop") / "reference"
    done = train(run)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return run


@pytest.fixture
def busy_machine() -> Iterator[None]:
    """Two processes that take all that they can get."""
    burn = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    yield
    for process in burn:
        process.kill()
        process.wait()


def test_train_leaves_everything_that_a_user_needs(reference: Path) -> None:
    for name in (
        "scenario.yaml",
        "log.lcm",
        "policy.safetensors",
        "summary.json",
        "curve.png",
        "report.html",
    ):
        assert (reference / name).stat().st_size > 0, name
    summary = json.loads((reference / "summary.json").read_text())
    assert summary["env_steps"] >= 150
    assert summary["fresh"]["last"]["episodes"] == 2
    assert summary["operator"]["success"] >= 0.9
    assert 0 <= summary["interventions"]["share"] <= 1


def test_log_does_not_depend_on_the_machines_load(
    reference: Path, tmp_path: Path, busy_machine: None
) -> None:
    done = train(tmp_path / "busy")
    assert done.returncode == 0, done.stderr[-3000:]
    events, difference = first_difference(reference / "log.lcm", tmp_path / "busy" / "log.lcm", ".*")
    assert difference is None, difference
    assert events > 1000
    assert (reference / "policy.safetensors").read_bytes() == (
        tmp_path / "busy" / "policy.safetensors"
    ).read_bytes()


def test_killed_controller_loses_at_most_the_running_episode(reference: Path, tmp_path: Path) -> None:
    run = tmp_path / "killed"
    in_files = {"run.log_file_mb": 1}
    process = subprocess.Popen(
        command(run, **in_files), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT
    )
    # Kill the controller as soon as a training episode is in its log.
    deadline = time.monotonic() + 180
    while not _controller_of(run) or not _count(run / "log.lcm", "EPISODE_END"):
        assert process.poll() is None and time.monotonic() < deadline, (
            "the run ended before it could be killed"
        )
        time.sleep(0.05)
    os.kill(_controller_of(run)[0], signal.SIGKILL)
    output, _ = process.communicate(timeout=120)
    assert process.returncode not in (0, None)
    assert "controller" in output
    done = train(run, **in_files)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
    # EPISODE_END carries the digest of its steps: equal ends are equal episodes.
    _, difference = first_difference(reference / "log.lcm", run / "log.lcm", "EPISODE_END|EPISODE_STEP")
    assert difference is None, difference
    assert (run / "log.lcm.01").exists()


def replay(run: Path) -> tuple[int, dict[str, Any]]:
    done = subprocess.run(
        [sys.executable, "-m", "tandem", "replay", str(run), "--json", "-"],
        capture_output=True,
        text=True,
        timeout=240,
        cwd=ROOT,
    )
    assert "{" in done.stdout, done.stdout + done.stderr
    return done.returncode, json.loads(done.stdout[done.stdout.index("{") :])


def test_replay_of_a_lockstep_log_finds_every_torque_again(reference: Path) -> None:
    code, result = replay(reference)
    assert code == 0, result
    assert result["differences"] == 0
    assert result["ticks"] == 100 * result["steps"] > 10_000
    assert result["torques_one_by_one"] > 0


def test_replay_finds_one_changed_bit_of_what_the_operator_said(reference: Path, tmp_path: Path) -> None:
    bytes_ = bytearray((reference / "log.lcm").read_bytes())
    # a command of the second demonstration that really moves the arm
    for found in re.finditer(b"TELEOP_COMMAND", bytes_):
        episode, _, twist_x = struct.unpack_from(">qqd", bytes_, found.end() + 16)  # after fingerprint, utime
        if episode == 1 and abs(twist_x) > 0.05:
            bytes_[found.end() + 32 + 5] ^= 1  # in the fraction
            break
    (tmp_path / "log.lcm").write_bytes(bytes_)
    code, result = replay(tmp_path)
    assert code == 1
    assert result["first_difference"]["episode"] == 1


@pytest.mark.parametrize("method", scenario.names(CONFIG / "methods"))
def test_controller_takes_every_method(tmp_path: Path, method: str) -> None:
    scenario.compose(CONFIG, "peg", method, {}).write(tmp_path / "scenario.yaml")
    check = [program("tandem_controller"), "--scenario", tmp_path / "scenario.yaml", "--check"]
    done = subprocess.run(check, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_stopped_arm_waits_for_an_order_and_the_fault_is_on_record(tmp_path: Path) -> None:
    run = tmp_path / "stopped"
    process = subprocess.Popen(
        command(
            run,
            "--clock",
            "realtime",
            **{"run.demonstrations": 1, "run.env_steps": 60, "controller.faults_in_a_row": 1000},
        ),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
    )
    deadline = time.monotonic() + 120
    while not _count(run / "log.lcm", "ACTION_CHUNK"):
        assert process.poll() is None and time.monotonic() < deadline, process.communicate()[0]
        time.sleep(0.05)

    def order(*words: str) -> subprocess.CompletedProcess[str]:
        words = (sys.executable, "-m", "tandem", "command", *words, "--run", str(run))
        return subprocess.run(words, capture_output=True, text=True, timeout=60, cwd=ROOT)

    stopped = order("estop")
    assert stopped.returncode == 0, stopped.stdout + stopped.stderr
    steps = _count(run / "log.lcm", "WORLD_STATE")
    time.sleep(1.0)
    # Nobody but a person clears a person's stop: the scripted operator is there, too.
    assert _count(run / "log.lcm", "WORLD_STATE") == steps
    recovered = order("recover")
    assert recovered.returncode == 0, recovered.stdout + recovered.stderr
    output, _ = process.communicate(timeout=180)
    assert process.returncode == 0, output
    faults = [event.message for event in messages(run / "log.lcm", "CONTROLLER_FAULT")]
    # A busy machine may add faults of its own: twenty cycles missed in a row.
    stops = [fault for fault in faults if "e-stop" in fault.sentence]
    assert len(stops) == 1
    assert 0 < stops[0].n_records <= 50
    ends = [event.message for event in messages(run / "log.lcm", "EPISODE_END")]
    assert [end.fault for end in ends if end.outcome == end.FAULT] == [
        fault.fault for fault in faults if fault.episode >= 0
    ]
    code, result = replay(run)
    assert code == 0, result


def test_stop_before_the_first_episode_is_on_record(tmp_path: Path) -> None:
    run, url = tmp_path / "early", processes.free_lcm_url()
    # Without a learner the first episode waits for its policy.
    composed = scenario.compose(CONFIG, "peg", "tandem", {}, ["run.demonstrations=0", "run.clock=realtime"])
    composed.write(tmp_path / "scenario.yaml")
    start: processes.Command = [
        *(program("tandem_controller"), "--scenario", tmp_path / "scenario.yaml"),
        *("--lcm-url", url, "--run", run),
    ]

    def order(*words: str) -> None:
        done = subprocess.run(
            [sys.executable, "-m", "tandem", "command", *words, "--lcm-url", url],
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 0, done.stdout + done.stderr

    def faults() -> list[Any]:
        return [event.message for event in messages(run / "log.lcm", "CONTROLLER_FAULT")]

    controller = processes.Child("controller", start, tmp_path / "controller.out")
    try:
        order("estop")
        deadline = time.monotonic() + 10
        while not faults() and time.monotonic() < deadline:
            time.sleep(0.05)
        (fault,) = faults()
        assert "e-stop" in fault.sentence
        assert (fault.episode, fault.n_records) == (-1, 0)  # nothing had moved
        order("recover")
        order("estop")
        order("recover")
    finally:
        assert controller.stop(10.0) in processes.STOPPED
    assert len(faults()) == 2
    # What no episode follows is not cut off when the run goes on.
    again = processes.Child("controller", start, tmp_path / "controller.out")
    try:
        order("estop")
    finally:
        assert again.stop(10.0) in processes.STOPPED
    assert len(faults()) == 3


def test_realtime_runs_on_the_wall_clock_and_counts_overruns(tmp_path: Path) -> None:
    run = tmp_path / "realtime"
    done = train(
        run,
        "--clock",
        "realtime",
        **{"run.demonstrations": 1, "run.env_steps": 20, "controller.faults_in_a_row": 1000},
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
    code, replayed = replay(run)
    assert code == 0, replayed
    assert replayed["torques_one_by_one"] == 7 * replayed["ticks"] > 0
    result = json.loads((run / "controller.json").read_text())
    assert result["ticks"] >= 2000
    assert result["overruns"] >= 0
    assert result["records_dropped"] == 0
    # One tick a millisecond, less what it waited between episodes.
    assert result["wall_s"] >= 0.9e-3 * result["ticks"]


def _count(log: Path, channel: str) -> int:
    """Events of a channel so far; not of its name, which stands in the texts of PROVENANCE too."""
    return sum(1 for _ in messages(log, channel)) if log.exists() else 0


def _controller_of(run: Path) -> list[int]:
    """Process ids of the controller that writes into `run`."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = entry.read_bytes().split(b"\0")
        except OSError:
            continue
        if words[0].endswith(b"tandem_controller") and any(str(run).encode() in word for word in words):
            found.append(int(entry.parent.name))
    return found


@pytest.fixture(scope="module")
def seeing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that looks through the wrist's two cameras."""
    run = tmp_path_factory.mktemp("full_loop") / "seeing"
    done = train(run, "--observe", "image", **SEES)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return run


SEES = {
    "run.env_steps": 40,
    "run.evaluation_every": 1000,
    "method.learner.image.updates_per_env_step": 0.5,
    "method.learner.image.batch": 32,
}


def test_policy_from_images_is_deployed_and_its_log_holds_all_that_it_learnt_from(
    seeing: Path, tmp_path: Path
) -> None:
    header = read_header(seeing / "policy.safetensors")
    assert header.architecture == "encoded"
    assert not any(name.startswith("goal_") for name in header.observation)
    assert header.config["cameras"] == [{"name": "wrist", "height": 64, "width": 128}]
    assert json.loads((seeing / "summary.json").read_text())["fresh"]["last"]["episodes"] == 2
    code, result = replay(seeing)
    assert code == 0 and result["differences"] == 0, result
    # the buffer and the policies that the run had, from its log alone
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "tandem",
            "train",
            "peg",
            "--from",
            str(seeing),
            "--run",
            str(tmp_path / "offline"),
        ],
        capture_output=True,
        text=True,
        timeout=240,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    offline = json.loads((tmp_path / "offline" / "offline.json").read_text())
    assert offline["buffer_equal"] is True
    assert offline["policies_equal"] and all(offline["policies_equal"].values())


def test_log_with_images_does_not_depend_on_the_machines_load(
    seeing: Path, tmp_path: Path, busy_machine: None
) -> None:
    done = train(tmp_path / "busy", "--observe", "image", **SEES)
    assert done.returncode == 0, done.stderr[-3000:]
    _, difference = first_difference(seeing / "log.lcm", tmp_path / "busy" / "log.lcm", ".*")
    assert difference is None, difference
