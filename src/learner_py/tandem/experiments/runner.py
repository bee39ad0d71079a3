"""Spreads runs over a machine, a few at a time.

What was done lies in the run folders alone: a finished run has its summary.json and is skipped, an unfinished one
goes on by its own command. So the same call goes on after Ctrl-C, kill -9 or a power cut, and repeats nothing.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tandem.experiments.machines import Machine, MachineError, Task
from tandem.experiments.runs import Run
from tandem.processes import Command, ending
from tandem.run_folder import RunFolderError, shown
from tandem.statistics import percent

POLL_S = 0.1


@dataclass
class Outcome:
    """failed: a sentence for each run that did not finish by its own fault."""

    failed: list[str] = field(default_factory=list)
    stopped: bool = False


@dataclass
class _Going:
    run: Run
    task: Task
    began: float  # s, monotonic
    out_start: int  # bytes of its output file that earlier calls wrote


def spread(
    runs: Sequence[Run],
    machine: Machine,
    jobs: int,
    say: Callable[[str], None],
    interrupted: Callable[[], int],
    command: Callable[[Run], Command] = Run.command,
) -> Outcome:
    """Brings all runs to their end, `jobs` at a time; one that fails does not keep the others from it.

    say: gets one line an event. interrupted: how often we were asked to stop; every time the runs that go are asked too
    (the second time a training ends at once). Runs that another call has locked are waited for.
    """
    return _Spread(runs, machine, jobs, say, interrupted, command).run()


class _Spread:
    def __init__(
        self,
        runs: Sequence[Run],
        machine: Machine,
        jobs: int,
        say: Callable[[str], None],
        interrupted: Callable[[], int],
        command: Callable[[Run], Command],
    ) -> None:
        self.machine, self.jobs, self.interrupted, self.command = machine, jobs, interrupted, command
        self.total = len(runs)
        self.waiting = [run for run in runs if not run.finished]
        self.going: list[_Going] = []
        self.done = self.total - len(self.waiting)  # finished or failed
        self.outcome = Outcome()
        self._told_to_be_in_use: set[Run] = set()
        self._say = say

    def say(self, event: str) -> None:
        self._say(f"[{self.done}/{self.total}] {event}")

    def run(self) -> Outcome:
        if self.waiting:
            before = f"{self.done} finished before, " if self.done else ""
            self._say(f"{self.total} runs: {before}{len(self.waiting)} to do, {self.jobs} at a time.")
        while self.waiting or self.going:
            if self.interrupted():
                self._stop()
                break
            self._collect()
            self._start_next()
            time.sleep(POLL_S)
        return self.outcome

    def _collect(self) -> None:
        for going in list(self.going):
            try:
                code = going.task.poll()
            except MachineError as error:
                self._fail(going, str(error))
                continue
            if code is None:
                continue
            if code != 0:
                self._fail(going, ending(code))
            elif not going.run.finished:
                self._fail(going, f"left no {going.run.folder.summary.name}")
            else:
                self.going.remove(going)
                self.done += 1
                self.say(
                    f"finished: {going.run}: {_success(going.run)}, {time.monotonic() - going.began:.0f} s"
                )

    def _fail(self, going: _Going, how: str) -> None:
        self.going.remove(going)
        self.done += 1
        last = _last_line(going.run.out, going.out_start)
        sentence = (
            f"{going.run}: the training {how}{f' ({last})' if last else ''}; see {shown(going.run.out)}"
        )
        self.outcome.failed.append(sentence)
        self.say(f"failed: {sentence}")

    def _start_next(self) -> None:
        for run in list(self.waiting):
            if len(self.going) >= self.jobs:
                return
            if run.finished:  # by another call, while we waited for it
                self.waiting.remove(run)
                self.done += 1
                self.say(f"finished by another call: {run}: {_success(run)}")
                continue
            if self._in_use(run):
                continue
            self.waiting.remove(run)
            goes_on = " again" if run.folder.scenario.exists() else ""
            out_start = run.out.stat().st_size if run.out.exists() else 0
            task = self.machine.start(str(run), self.command(run), run.out)
            self.going.append(_Going(run, task, time.monotonic(), out_start))
            self.say(f"started{goes_on}: {run} -> {shown(run.folder.path)}")

    def _in_use(self, run: Run) -> bool:
        """Whether another call holds the folder: a person's, or one that is still ending after our kill -9."""
        try:
            run.folder.lock().close()
        except RunFolderError:
            if run not in self._told_to_be_in_use:
                self._told_to_be_in_use.add(run)
                self.say(f"waiting: {run}: {shown(run.folder.path)} is in use by another call")
            return True
        return False

    def _stop(self) -> None:
        self.outcome.stopped = True
        asked = 0
        if self.going:
            self._say(f"Stopping {len(self.going)} runs in good order ...")
        while self.going:
            if asked < self.interrupted():
                asked = self.interrupted()
                for going in self.going:
                    going.task.interrupt()
            for going in list(self.going):
                try:
                    ended = going.task.poll() is not None
                except MachineError:
                    ended = True
                if ended:
                    self.going.remove(going)
                    self.done += going.run.finished
                    self.say(f"{'finished' if going.run.finished else 'stopped'}: {going.run}")
            time.sleep(POLL_S)


def _success(run: Run) -> str:
    try:
        fresh = json.loads(run.folder.summary.read_text())["fresh"]["selected"]
        return percent(fresh["successes"], fresh["episodes"])
    except (OSError, ValueError, KeyError, TypeError):
        return "its summary can't be read"


def _last_line(out: Path, start: int) -> str:
    """The last sentence of the command that was written to `out` from byte `start` on, else its last line."""
    try:
        with out.open("rb") as file:
            file.seek(start)
            text = file.read().decode("utf-8", "replace")
    except OSError:
        return ""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    sentences = [line for line in lines if line.startswith("tandem: ")]
    return (sentences or lines or [""])[-1].removeprefix("tandem: ").rstrip(".")
