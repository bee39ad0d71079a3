"""Spreading runs: at the same time, past failures, over Ctrl-C and kill -9."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tandem.experiments.machines import MachineError, RayMachine, ThisMachine, shares
from tandem.experiments.runner import Outcome, spread
from tandem.experiments.runs import Run
from tandem.run_folder import RunFolder

FAKE = Path(__file__).parent / "fakes" / "train.py"

DRIVER = f"""
import sys
from pathlib import Path
sys.path[:0] = [{str(Path(__file__).parent)!r}]
import test_runner as t
from tandem.processes import interruptible
folder, seconds, labels = Path(sys.argv[1]), float(sys.argv[2]), sys.argv[3:]
with interruptible() as interrupted:
    outcome = t.go(t.runs(folder, *labels), seconds, jobs=2, interrupted=interrupted)
sys.exit(130 if outcome.stopped else 0)
"""


def runs(folder: Path, *labels: str) -> list[Run]:
    return [Run(label, "peg", "tandem", 0, RunFolder(folder / f"{label}-seed0")) for label in labels]


def go(
    wanted: list[Run],
    seconds: float,
    jobs: int,
    interrupted: Callable[[], int] = lambda: 0,
    said: list[str] | None = None,
) -> Outcome:
    def say(line: str) -> None:
        print(line, flush=True)
        if said is not None:
            said.append(line)

    def command(run: Run) -> list[str]:
        return [sys.executable, str(FAKE), str(run.folder.path), str(seconds)]

    return spread(wanted, ThisMachine(jobs), jobs, say, interrupted, command)


def times(run: Run, name: str) -> list[float]:
    file = run.folder.path / name
    return [float(line) for line in file.read_text().split()] if file.exists() else []


def start(folder: Path, seconds: float, *labels: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", DRIVER, str(folder), str(seconds), *labels]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


def test_as_many_runs_as_jobs_go_at_the_same_time_and_no_more(tmp_path: Path) -> None:
    wanted = runs(tmp_path, "a", "b", "c", "d")
    assert go(wanted, 0.5, jobs=2) == Outcome()
    spans = [(times(run, "starts")[0], times(run, "ends")[0]) for run in wanted]
    together = [sum(begin <= at < end for begin, end in spans) for at, _ in spans]
    assert max(together) == 2


def test_cores_are_shared_out_once_and_left_alone_when_there_are_too_few() -> None:
    assert shares([2, 3], 1) == [[2, 3]]
    assert shares([0, 1, 2, 3, 4], 2) == [[0, 2, 4], [1, 3]]
    assert shares([0, 1], 3) == []


def test_runs_at_the_same_time_have_cores_of_their_own(tmp_path: Path) -> None:
    machine = ThisMachine(2)
    wanted = runs(tmp_path, "a", "b", "c", "d")
    assert spread(wanted, machine, 2, print, lambda: 0, lambda run: fake(run, 0.5)) == Outcome()
    first, second, *later = [(run.folder.path / "cores").read_text() for run in wanted]
    assert len({first, second}) == min(2, machine.cores)  # with one core they have to share it
    assert set(later) == {first, second}


def test_each_event_is_one_line_with_what_is_done_of_all(tmp_path: Path) -> None:
    said: list[str] = []
    go(runs(tmp_path, "a", "b"), 0.0, jobs=1, said=said)
    assert said[0] == "2 runs: 2 to do, 1 at a time."
    assert said[1].startswith("[0/2] started: a, seed 0 -> ")
    assert said[2].startswith("[1/2] finished: a, seed 0: 90.0 % [59.6, 98.2] (9/10), ")
    assert said[-1].startswith("[2/2] finished: b, seed 0: ")


def test_a_failing_run_is_told_in_a_sentence_and_the_others_go_on(tmp_path: Path) -> None:
    wanted = runs(tmp_path, "FAIL", "b", "c")
    said: list[str] = []
    outcome = go(wanted, 0.1, jobs=1, said=said)
    sentence = (
        "FAIL, seed 0: the training ended with exit code 3 (the arm has no power);"
        f" see {tmp_path}/FAIL-seed0.out"
    )
    assert outcome == Outcome(failed=[sentence])
    assert f"[1/3] failed: {sentence}" in said
    assert [run.finished for run in wanted] == [False, True, True]
    assert "begun" in (tmp_path / "FAIL-seed0.out").read_text()


def test_a_training_that_leaves_no_summary_has_failed(tmp_path: Path) -> None:
    wanted = runs(tmp_path, "a")
    outcome = spread(wanted, ThisMachine(), 1, print, lambda: 0, lambda run: ["true"])
    assert outcome.failed == [f"a, seed 0: the training left no summary.json; see {tmp_path}/a-seed0.out"]


def test_what_is_finished_is_never_started_again(tmp_path: Path) -> None:
    wanted = runs(tmp_path, "a", "b")
    go(wanted[:1], 0.0, jobs=1)
    go(wanted, 0.0, jobs=2)
    go(wanted, 0.0, jobs=2)
    assert [len(times(run, "starts")) for run in wanted] == [1, 1]


def test_ctrl_c_ends_the_runs_in_order_by_sigint(tmp_path: Path) -> None:
    wanted = runs(tmp_path, "a", "b", "c")
    process = start(tmp_path, 60.0, "a", "b", "c")
    wait_for(lambda: all(times(run, "starts") for run in wanted[:2]))
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=20)
    assert process.returncode == 130, out
    assert "Stopping 2 runs in good order ..." in out
    for run in wanted[:2]:
        assert (run.folder.path / "stopped_by").read_text() == "SIGINT"
    assert not times(wanted[2], "starts")
    assert go(wanted, 0.0, jobs=2) == Outcome()
    assert [len(times(run, "starts")) for run in wanted] == [2, 2, 1]


def test_a_killed_runner_goes_on_and_repeats_nothing_that_was_finished(tmp_path: Path) -> None:
    wanted = runs(tmp_path, "a", "b", "c", "d")
    go(wanted[:1], 0.0, jobs=1)
    process = start(tmp_path, 2.0, "a", "b", "c", "d")
    wait_for(lambda: bool(times(wanted[1], "starts") and times(wanted[2], "starts")))
    process.kill()
    process.communicate()
    for run in wanted[1:3]:  # nobody is left behind
        wait_for(lambda run=run: (run.folder.path / "stopped_by").exists())
    assert go(wanted, 0.0, jobs=2) == Outcome()
    assert [len(times(run, "starts")) for run in wanted] == [1, 2, 2, 1]
    assert [len(times(run, "ends")) for run in wanted] == [1, 1, 1, 1]


def test_a_folder_in_use_by_another_call_is_waited_for(tmp_path: Path) -> None:
    wanted = runs(tmp_path, "a", "b")
    lock = wanted[0].folder.lock()  # as by a training that is still ending after a kill -9
    said: list[str] = []

    def say(line: str) -> None:
        said.append(line)
        if "finished: b" in line:
            lock.close()

    def command(run: Run) -> list[str]:
        return [sys.executable, str(FAKE), str(run.folder.path), "0"]

    assert spread(wanted, ThisMachine(), 2, say, lambda: 0, command) == Outcome()
    assert sum("a-seed0 is in use by another call" in line for line in said) == 1
    assert [len(times(run, "starts")) for run in wanted] == [1, 1]


def test_missing_ray_is_a_sentence_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MachineError, match=r"--ray needs Ray, .* install it by .*requirements-ray\.txt"):
        RayMachine("local")


def test_a_ray_that_is_not_there_is_a_sentence() -> None:
    with pytest.raises(MachineError, match=r"--ray nonsense: Ray can't be reached there \("):
        RayMachine("nonsense")


def test_ray_runs_the_same_commands_at_once_past_failures_and_stops_in_order(tmp_path: Path) -> None:
    machine = RayMachine("local", jobs=2)  # a missing Ray fails here: ./tandem test installs it
    try:
        wanted = runs(tmp_path, "a", "b", "FAIL")
        outcome = spread(wanted, machine, 3, print, lambda: 0, lambda run: fake(run, 2.0))
        assert [run.finished for run in wanted] == [True, True, False]
        assert "ended with exit code 3 (the arm has no power)" in outcome.failed[0]
        assert "begun" in wanted[0].out.read_text()
        assert max(times(run, "starts")[0] for run in wanted[:2]) < times(wanted[0], "ends")[0]

        more = runs(tmp_path, "c")
        begun = time.monotonic()
        stopped = spread(
            more, machine, 1, print, lambda: len(times(more[0], "starts")), lambda r: fake(r, 60.0)
        )
        assert stopped == Outcome(stopped=True)
        assert (more[0].folder.path / "stopped_by").read_text() == "SIGINT"
        assert time.monotonic() - begun < 30.0
    finally:
        machine.close()


def fake(run: Run, seconds: float) -> list[str]:
    return [sys.executable, str(FAKE), str(run.folder.path), str(seconds)]
