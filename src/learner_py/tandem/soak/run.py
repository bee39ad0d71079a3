"""A soak from start to orderly end: three programs, a monkey, and then the questions."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.controller_status_t import controller_status_t

from tandem import processes
from tandem.orders import Order
from tandem.processes import Child
from tandem.run_folder import RunFolder
from tandem.soak.ear import Ear
from tandem.soak.monkey import Monkey
from tandem.soak.programs import Programs
from tandem.soak.setting import soak_scenario
from tandem.wire import Wire

STEP_S = 0.02
STATUS_WITHIN_S = 5.0  # ten a second are due; a process that is silent for so long hangs
PROGRESS_WITHIN_S = 120.0  # no tick for so long, though every stop is recovered: nothing goes on any more
SETTLE_AT_LEAST_S = 2.0  # so that the last deed has had its effect
SETTLE_S = 120.0  # for the learner to catch up at the end
CONTROLLER_END_S, LEARNER_END_S = 15.0, 90.0


@dataclass
class Soaked:
    """What is left of a soak, besides its log."""

    seconds: float
    ear: Ear
    monkey: Monkey
    broken: str | None  # a sentence when it had to end early, or could not end well
    exit_codes: dict[str, int | None]


class Broken(Exception):
    """A sentence: what in the product went wrong."""


def soak(folder: RunFolder, seed: int, seconds: float, say: Callable[[str], None]) -> Soaked:
    """seconds: of the arm's motion. @raises ScenarioError, OSError; Broken only inside."""
    scenario = soak_scenario(seed)
    scenario.write(folder.scenario)
    url = processes.free_lcm_url()
    folder.lcm_url.write_text(url + "\n")
    programs = Programs(folder, url)
    if sentence := programs.missing():
        raise OSError(sentence)
    ear = Ear(url)
    started = time.monotonic()
    broken = None
    try:
        programs.start_all()
        monkey = Monkey(seed, folder, scenario, programs, ear, url)
        course = _Course(programs, ear, monkey, say)
        try:
            course.go_on_for(seconds)
            course.settle()
            course.end(Wire(url))
        except Broken as finding:
            broken = str(finding)
    finally:
        programs.end_all()
        folder.lcm_url.unlink(missing_ok=True)
        ear.close()
    codes = {name: child.poll() for name, child in programs.children.items()}
    return Soaked(time.monotonic() - started, ear, monkey, broken, codes)


class _Course:
    def __init__(self, programs: Programs, ear: Ear, monkey: Monkey, say: Callable[[str], None]) -> None:
        self.programs, self.ear, self.monkey, self.say = programs, ear, monkey, say
        self._ticks = -1
        self._ticked_at = time.monotonic()
        self._told_at = 0.0

    def go_on_for(self, seconds: float) -> None:
        """seconds: of motion; what the arm waits between episodes and after faults does not count."""
        while self._ticks < 1000 * seconds:
            self.monkey.step()
            self._watch()

    def settle(self) -> None:
        """No more mischief; until all programs are there and the learner is with the controller."""
        began = time.monotonic()
        while time.monotonic() < began + SETTLE_AT_LEAST_S or not (
            self.monkey.made_good and self._caught_up()
        ):
            if time.monotonic() > began + SETTLE_S:
                raise Broken(
                    f"{SETTLE_S:.0f} s after the last mischief the learner has not caught up: it is trained through "
                    f"episode {self.ear.learner and self.ear.learner.episodes_trained_through}, the controller runs "
                    f"episode {self.ear.status and self.ear.status.episode}."
                )
            self.monkey.step(mischief=False)
            self._watch()

    def end(self, wire: Wire) -> None:
        """STOP, then each program ends by itself."""
        stop = Order(controller_command_t.STOP, "the soak is over", self.ear.status, time.monotonic())

        def send_stop() -> None:
            if stop.due(time.monotonic()):
                wire.publish(stop.message())

        self._wait_for_end("controller", CONTROLLER_END_S, (0, 130), send_stop)
        self._wait_for_end("operator", 5.0, (0,), lambda: None)
        self._wait_for_end("learner", LEARNER_END_S, (0,), lambda: None)
        time.sleep(0.5)  # the learner's last words

    def _caught_up(self) -> bool:
        status, learner = self.ear.status, self.ear.learner
        if status is None or learner is None or status.state != controller_status_t.RUNNING:
            return False
        return learner.episodes_trained_through >= status.episode - 1 and status.episodes_unacknowledged == 0

    def _wait_for_end(
        self, name: str, seconds: float, good: tuple[int, ...], meanwhile: Callable[[], None]
    ) -> None:
        until = time.monotonic() + seconds
        while self.programs.alive(name):
            if time.monotonic() > until:
                raise Broken(f"the {name} had not ended {seconds:.0f} s after the STOP.")
            meanwhile()
            time.sleep(STEP_S)
        child = self.programs.children[name]
        if child.poll() not in good:
            raise Broken(f"At the end: {child.death()}")

    def _watch(self) -> None:
        """A fiftieth of a second; @raises Broken when something ended, hangs or stands still."""
        time.sleep(STEP_S)
        if self.programs.ended_by_themselves():
            time.sleep(2.0)  # who ended first may have drawn others with it
            ended: list[Child] = self.programs.ended_by_themselves()
            raise Broken("\n".join(child.death() for child in ended))
        now = time.monotonic()
        status: Any = self.ear.status
        if status is None:
            if now - self.programs.started_at["controller"] > 60.0:
                raise Broken("the controller has said nothing for 60 s since its start.")
            return
        if now - self.ear.status_at > STATUS_WITHIN_S:
            raise Broken(f"the controller runs, but has said nothing for {STATUS_WITHIN_S:.0f} s.")
        if status.ticks != self._ticks:
            self._ticks, self._ticked_at = status.ticks, now
        elif now - self._ticked_at > PROGRESS_WITHIN_S:
            raise Broken(
                f"the arm has stood still for {PROGRESS_WITHIN_S:.0f} s: state {status.state}, fault {status.fault}, "
                f"waiting for: {status.waiting_for or 'nothing'}."
            )
        if now - self._told_at > 15.0:
            self._told_at = now
            self.say(
                f"episode {status.episode}, {status.ticks / 1000:.0f} s of motion, policy {status.policy_version}, "
                f"{sum(self.ear.faults.values())} faults"
            )
