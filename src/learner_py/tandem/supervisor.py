"""`tandem train`: starts controller, operator and learner, watches them, evaluates, and sums the run up.

A run can be stopped at any moment (Ctrl-C, kill -9) and continued by the same command; all that it needs for
that lies in RUN/. The order of ending is always: controller first, so that the arm holds, then operator,
then learner.
"""

import contextlib
import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.live import Live
from tandem_lcm.tandem.controller_status_t import controller_status_t

from tandem import demonstrations, live_view, processes, summary
from tandem.checkpoints import Checkpoints
from tandem.conclusion import conclude
from tandem.evaluation import EvaluationError
from tandem.lent_terminal import COMEBACK_S, LentTerminal
from tandem.listener import Listener
from tandem.live_plots import LivePlots
from tandem.processes import Child
from tandem.run_clock import Clock
from tandem.run_folder import RunFolder, RunFolderError, program, shown
from tandem.scenario import LOG_LIMITS, Scenario, ScenarioError, load

PLAIN_INTERVAL_S = 5.0  # a line when stdout is no terminal
CONTROLLER_PATIENCE_S = 10.0  # to bring the arm to rest and close the log
OPERATOR_PATIENCE_S = 5.0
LEARNER_PATIENCE_S = 60.0  # to save its checkpoint
FAREWELL_S = 10.0  # between the ends of programs that belong together

STOPPED_BY_REQUEST = tuple(code for code in processes.STOPPED if code != 0)


class TrainingError(Exception):
    """A sentence, and the exit code that goes with it."""

    def __init__(self, sentence: str, exit_code: int = 1) -> None:
        super().__init__(sentence)
        self.exit_code = exit_code


class Interrupted(Exception):
    """The user, or the system, asked us to stop."""


@dataclass
class Settings:
    """What the command line asked for."""

    folder: RunFolder
    scenario: Scenario
    resume_command: str
    lcm_url: str | None = None
    fresh: bool = False
    operator: str = "scripted"  # or keyboard, gamepad; or none: a program of the user's answers WORLD_STATE
    demonstrations: Path | None = None  # a log whose demonstrations a new run begins with


def train(settings: Settings, console: Console) -> int:
    """Runs the training to its end. Returns the exit code; failures are printed as sentences."""
    try:
        with processes.interruptible() as interrupted:
            return _Supervisor(settings, console, interrupted).run()
    except (TrainingError, RunFolderError, EvaluationError) as error:
        _complain(str(error))
        return getattr(error, "exit_code", 1)
    except OSError as error:
        _complain(
            f"{error.filename or settings.folder.path}: {error.strerror}. What is in the log is kept; mend this "
            f"(disk space, permissions) and go on:\n  {settings.resume_command}"
        )
        return 1
    except Interrupted:
        with contextlib.suppress(OSError):  # the terminal may be what was lost
            console.print(
                "Stopped; nothing is lost. To go on:\n  " + settings.resume_command,
                soft_wrap=True,
                highlight=False,
            )
        return 130


def _complain(sentence: str) -> None:
    print(f"tandem: {sentence}", file=sys.stderr, flush=True)


def open_run(settings: Settings, console: Console) -> bool:
    """Decides between a new run and going on with the one in the folder. True: resumed.

    @raises TrainingError when the folder holds a run of another scenario.
    """
    folder, scenario = settings.folder, settings.scenario
    if not folder.scenario.exists() or settings.fresh:
        if settings.fresh and folder.path.exists():
            console.print(f"The old run is kept as {shown(folder.set_aside())}.")
        scenario.write(folder.scenario)
        return False
    begun = bool(summary.read_episodes(folder.log))
    before = load(folder.scenario)
    difference = scenario.first_difference(before)
    if difference is None:
        if any(scenario.run[key] != before.run.get(key) for key in LOG_LIMITS):
            scenario.write(folder.scenario)
        return begun
    if begun:
        raise TrainingError(
            f"{shown(folder.path)} holds a run of another scenario: {difference}."
            " Give --fresh to start anew (the old folder is kept under another name), or --run DIR.",
            exit_code=2,
        )
    if folder.log.exists():
        console.print(f"The folder's run had no episode yet; it is kept as {shown(folder.set_aside())}.")
    scenario.write(folder.scenario)
    return False


class _Supervisor:
    def __init__(self, settings: Settings, console: Console, interrupted: Callable[[], int]) -> None:
        self.settings = settings
        self.console = console
        self.interrupted = interrupted
        self.folder = settings.folder
        self.scenario = settings.scenario
        self.progress = live_view.Progress()
        self.children: dict[str, Child] = {}
        self.started = time.monotonic()
        self._last_line = -math.inf
        self._live: Live | None = None
        self._lent = LentTerminal(settings.operator)
        self._quota_told = False

    # ---- the run from top to bottom

    def run(self) -> int:
        lock = self.folder.lock()
        try:
            resumed = open_run(self.settings, self.console)
            if resumed and self.folder.summary.exists():
                self.console.print(f"{shown(self.folder.path)} is finished; --fresh starts it anew.")
                self.console.print(summary.table(json.loads(self.folder.summary.read_text())))
                return 0
            if self.settings.demonstrations and not self.folder.log.exists():
                demonstrations.begin(self.folder.log, self.scenario, self.settings.demonstrations)
            self.clock = Clock(self.folder.clock)
            self.clock.value["resumed"] += int(resumed)
            self._recall()
            try:
                self._check_scenario()
                if not self._trained():
                    with self._told_in_file() if self._lent.person else self._view():
                        self._start()
                        self._watch()
                        self._end_operator()
                    with self._view():
                        self._farewell()
                with self._view():
                    value = conclude(
                        self.folder,
                        self.scenario,
                        self.checkpoints,
                        self.clock,
                        self.settings.operator,
                        self._wait_after,
                        self._say,
                    )
            finally:
                self._end_all()
                self.plots.close()
                self.folder.lcm_url.unlink(missing_ok=True)
                self.clock.save()
        finally:
            lock.close()
        self.console.print(summary.table(value))
        files = ("policy.safetensors", "summary.json", "report.html", "curve.png", "demo.mp4")
        left = ", ".join(name for name in files if (self.folder.path / name).exists())
        self._say(f"{shown(self.folder.path)}: {left}")
        return 0

    def _recall(self) -> None:
        """What an earlier call already did: episodes for the view, evaluations that need not run again."""
        for end in summary.read_episodes(self.folder.log):
            self.progress.on_episode(end)
        self.checkpoints = Checkpoints(self.folder, self.scenario)
        self.plots = LivePlots(self.folder.tensorboard, self._say, self.checkpoints.evaluated)

    def _check_scenario(self) -> None:
        """Learner and controller judge the sections that they read before anything starts."""
        if processes.LEARNER_STAND_IN not in os.environ:
            from tandem.learner.config import load_scenario

            try:
                load_scenario(self.folder.scenario)
            except ScenarioError as error:
                raise TrainingError(self.scenario.explain(str(error)), exit_code=2) from None
        for name in ("tandem_controller", "tandem_operator"):
            command: processes.Command = [program(name), "--scenario", self.folder.scenario, "--check"]
            if sentence := processes.missing_program(command):
                raise TrainingError(sentence)
            check = Child("check of the scenario", command, self.folder.path / "check.out")
            if check.wait(30.0) != 0:
                raise TrainingError(
                    self.scenario.explain("\n".join(check.last_lines()) or check.death()), exit_code=2
                )

    def _trained(self) -> bool:
        """True when an earlier call trained to the end and only the final evaluation is left."""
        episodes = summary.training_episodes(summary.read_episodes(self.folder.log))
        steps = max((end.env_steps_total for end in episodes), default=0)
        return steps >= self.scenario.run["env_steps"] and steps in self.folder.checkpoints()

    def _start(self) -> None:
        url = self.settings.lcm_url or os.environ.get("LCM_DEFAULT_URL") or processes.free_lcm_url()
        try:
            self.listener = Listener(url, self.folder, self.progress, self.clock, self.plots)
        except RuntimeError as error:
            raise TrainingError(
                f"LCM can't open {url} ({error}); ./tandem doctor tells what is missing."
            ) from None
        path = self.folder.path
        common: processes.Command = ["--scenario", self.folder.scenario, "--lcm-url", url]
        commands: dict[str, processes.Command] = {
            "learner": [*processes.learner_command(), *common, "--run", path],
            "controller": [
                program("tandem_controller"),
                *common,
                "--run",
                path,
                "--results",
                path / "controller.json",
            ],
        }
        if self.settings.operator == "scripted":
            commands["operator"] = [program("tandem_operator"), *common]
        elif self._lent.person:
            teleop = [sys.executable, "-m", "tandem", "teleop", self.settings.operator, "--within-training"]
            commands["operator"] = [*teleop, "--run", path, "--lcm-url", url]
        for command in commands.values():
            if sentence := processes.missing_program(command):
                raise TrainingError(sentence)
        self._say(f"Training in {shown(path)}; to look on: LCM_DEFAULT_URL='{url}'")
        self.folder.lcm_url.write_text(url + "\n")
        for name, command in commands.items():
            person = name == "operator" and self._lent.person
            self.children[name] = Child(name, command, path / f"{name}.out", terminal=person)

    # ---- while it trains

    def _watch(self) -> None:
        """Until the controller has finished; raises when anything else happens."""
        controller = self.children["controller"]
        while (code := controller.poll()) is None:
            self._tick(self.progress.phase)
            for name, child in list(self.children.items()):
                if name != "controller" and child.poll() is not None:
                    self._ended_early(child)
        if code in STOPPED_BY_REQUEST:
            self._say("The controller was asked to stop by another program.")
            raise Interrupted
        if code != 0:
            raise TrainingError(self.scenario.explain(controller.death()), exit_code=2 if code == 2 else 1)

    def _ended_early(self, child: Child) -> None:
        """Operator or learner ended; fine only when the controller is ending as well.

        A person's program is started again: meanwhile the controller has held the arm and handed it back.
        """
        if child.name == "operator" and not self._controller_ends() and self._lent.may_come_back():
            self._say(child.death())
            self._bring_back(child)
            return
        deadline = time.monotonic() + (FAREWELL_S if child.poll() == 0 or self._controller_ends() else 1.0)
        while self.children["controller"].poll() is None:
            if time.monotonic() > deadline:
                raise TrainingError(self.scenario.explain(child.death()))
            self._tick(self.progress.phase)

    def _bring_back(self, person: Child) -> None:
        self._lent.take_back(person)
        deadline = time.monotonic() + COMEBACK_S
        while time.monotonic() < deadline and self.children["controller"].poll() is None:
            self._tick(self.progress.phase)
        self._say(f"The {person.name} is started again.")
        self.children["operator"] = Child(person.name, person.command, person.out, terminal=True)

    def _controller_ends(self) -> bool:
        status = self.progress.status
        return status is not None and status.state in (
            controller_status_t.FINISHED,
            controller_status_t.FAULTED,
        )

    def _end_operator(self) -> None:
        if operator := self.children.get("operator"):
            operator.stop(OPERATOR_PATIENCE_S)
            self._lent.take_back(operator)

    def _farewell(self) -> None:
        """After the controller's good end the learner trains what is left and writes its last checkpoint."""
        learner = self.children["learner"]
        episodes = summary.read_episodes(self.folder.log)
        last = episodes[-1].episode if episodes else -1
        idle_since = time.monotonic()
        while (code := learner.poll()) is None:
            self._tick("training")
            report = self.progress.learner
            if report is None or report.training or report.episodes_trained_through < last:
                idle_since = time.monotonic()
            elif time.monotonic() - idle_since > FAREWELL_S:
                # It has trained on everything but missed the controller's last words.
                code = learner.stop(LEARNER_PATIENCE_S)
                break
        if code not in processes.STOPPED:
            raise TrainingError(self.scenario.explain(learner.death()))

    def _tick(self, part: str) -> None:
        """A tenth of a second: listen, evaluate, show."""
        if self.interrupted():
            raise Interrupted
        deadline = time.monotonic() + 0.1
        while (left := deadline - time.monotonic()) > 0:
            self.listener.handle(left)
        self.clock.spend(part)
        if self.progress.status is not None:
            self.clock.value["overruns"] = self.progress.status.overruns
            self._tell_of_quota()
        self.checkpoints.look(self.clock)
        self.checkpoints.poll(slots=1)
        self.plots.evaluations(self.checkpoints.evaluated)
        self._show()

    def _tell_of_quota(self) -> None:
        """Once, when the log is as large as it may become."""
        if self._quota_told or not self.progress.status.episodes_without_motion:
            return
        self._quota_told = True
        self._say(
            f"The log has reached run.log_quota_mb ({self.scenario.run['log_quota_mb']} MB): learning goes on, and"
            " motion is recorded no more. To record it again, stop and call again with a larger one."
        )

    def _wait_after(self, doing: str) -> None:
        """A tenth of a second of the final evaluation: book it, show it."""
        if self.interrupted():
            raise Interrupted
        time.sleep(0.1)
        self.clock.spend("final evaluation")
        self.plots.evaluations(self.checkpoints.evaluated)
        self._show(doing)

    # ---- ending

    def _end_all(self) -> None:
        """Ends what still runs; at once when asked a second time."""
        self.checkpoints.stop()
        patience = {
            "controller": CONTROLLER_PATIENCE_S,
            "operator": OPERATOR_PATIENCE_S,
            "learner": LEARNER_PATIENCE_S,
        }
        asked = self.interrupted()
        for name, seconds in patience.items():
            child = self.children.get(name)
            if child is None or child.poll() is not None:
                continue
            child.send(signal.SIGTERM)
            deadline = time.monotonic() + seconds
            while (
                child.poll() is None and time.monotonic() < deadline and self.interrupted() <= max(asked, 1)
            ):
                time.sleep(0.02)
            if child.poll() is None:
                _complain(f"The {name} did not end within {seconds:.0f} s of being asked and was killed.")
                child.send(signal.SIGKILL)
                child.wait(1.0)
            if name == "operator":
                self._lent.take_back(child)

    # ---- showing

    @contextlib.contextmanager
    def _told_in_file(self) -> Iterator[None]:
        """While a person has the terminal."""
        ours = self.console
        with self._lent.writing_to(self.folder.progress_text) as self.console:
            try:
                yield
            finally:
                self.console = ours

    @contextlib.contextmanager
    def _view(self) -> Iterator[None]:
        if not self.console.is_terminal:
            yield
            return
        with Live(console=self.console, auto_refresh=False, transient=True) as self._live:
            yield
        self._live = None

    def _say(self, sentence: str) -> None:
        self.console.print(sentence, soft_wrap=True, highlight=False, markup=False)

    def _show(self, doing: str | None = None) -> None:
        now = time.monotonic()
        if now - self._last_line < (0.25 if self._live else PLAIN_INTERVAL_S):
            return
        self._last_line = now
        rows = live_view.rows(
            self.progress, self.scenario, self.checkpoints.evaluated, self.checkpoints.running
        )
        if doing:
            rows = {"phase": doing, **{k: rows[k] for k in ("evaluation",) if k in rows}}
        run = self.scenario.run
        if self._live:
            title = f"{run['task']} · {run['method']} · seed {run['seed']} · {shown(self.folder.path)}"
            title += " · Ctrl-C stops, the same command resumes"
            self._live.update(live_view.panel(title, rows, self.progress), refresh=True)
        else:
            self._say(live_view.line(now - self.started, rows))
