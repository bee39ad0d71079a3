"""What a training run is doing now: `Progress` collects the LCM messages, `panel` and `line` show them."""

import math
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from rich.console import Group
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.learner_status_t import learner_status_t
from tandem_lcm.tandem.robot_state_t import robot_state_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.faults import fault_text
from tandem.scenario import Scenario
from tandem.statistics import percent, share
from tandem.words import PHASES, ROBOT_MODES, STATES

RECENT = 20  # episodes


@dataclass
class Progress:
    """The latest of everything, from the three programs' own messages."""

    status: Any = None  # controller_status_t
    learner: Any = None  # learner_status_t
    robot: bytes = b""  # the latest ROBOT_STATE, decoded only when shown
    demonstrations: int = 0  # successful ones
    last_episode: int = -1
    recent: deque[Any] = field(default_factory=lambda: deque(maxlen=RECENT))  # episode_end_t of training
    steps_seen: deque[tuple[float, int]] = field(
        default_factory=lambda: deque(maxlen=120)
    )  # (s, env_steps_total)

    def on_episode(self, end: Any) -> None:
        """Takes an EPISODE_END; it is sent again until acknowledged, so each number counts once."""
        if end.episode <= self.last_episode:
            return
        self.last_episode = end.episode
        if end.phase == world_state_t.DEMONSTRATION and end.outcome == episode_end_t.SUCCESS:
            self.demonstrations += 1
        elif end.phase == world_state_t.TRAINING:
            self.recent.append(end)

    def on_status(self, data: bytes) -> None:
        self.take_status(controller_status_t.decode(data))

    def take_status(self, status: Any) -> None:
        self.status = status
        if not self.steps_seen or time.monotonic() - self.steps_seen[-1][0] > 0.25:
            self.steps_seen.append((time.monotonic(), self.status.env_steps_total))

    def on_learner(self, data: bytes) -> None:
        self.learner = learner_status_t.decode(data)

    @property
    def phase(self) -> str:
        """demonstrations, warm start, training ...; `start` before the first status."""
        if self.status is None:
            return "start"
        phase = PHASES.get(self.status.phase, "?")
        waiting = self.status.state == controller_status_t.WAITING
        if phase == "training" and self.status.env_steps_total == 0 and waiting:
            return "warm start"
        return phase

    @property
    def env_steps_per_s(self) -> float:
        """Over the last half minute."""
        if len(self.steps_seen) < 2:
            return 0.0
        (t0, n0), (t1, n1) = self.steps_seen[0], self.steps_seen[-1]
        return share(n1 - n0, t1 - t0)

    @property
    def successes(self) -> int:
        return sum(end.outcome == episode_end_t.SUCCESS for end in self.recent)

    @property
    def human_share(self) -> float:
        """Share of the recent training episodes' steps with the human engaged."""
        return share(sum(e.n_intervention_steps for e in self.recent), sum(e.n_steps for e in self.recent))


def _number(value: float, digits: int = 4) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}g}"


def _share(value: float) -> str:
    return "-" if math.isnan(value) else f"{100 * value:.0f} %"


def rows(
    progress: Progress, scenario: Scenario, evaluated: dict[int, dict[str, Any]], running: list[str]
) -> dict[str, str]:
    """The view as label -> text."""
    status, learner = progress.status, progress.learner
    shown = {"phase": "starting"}
    if status is not None:
        state = STATES.get(status.state, "?")
        shown["phase"] = f"{progress.phase}, episode {status.episode}, {state}"
        if progress.phase == "demonstrations":
            shown["demonstrations"] = f"{progress.demonstrations} of {scenario.run['demonstrations']}"
        rate = progress.env_steps_per_s
        hz = scenario.data["task"].get("policy_rate_hz", 10)
        shown["env steps"] = (
            f"{status.env_steps_total} of {status.env_steps_budget}, {rate:.0f} /s"
            f" ({rate / hz:.1f} x real time)"
        )
    if progress.recent:
        n = len(progress.recent)
        shown["success"] = f"{progress.successes} of the last {n} ({100 * progress.successes / n:.0f} %)"
        shown["human"] = f"{_share(progress.human_share)} of the steps of the last {n}"
    if progress.robot:
        robot = robot_state_t.decode(progress.robot)
        shown["arm"] = f"{ROBOT_MODES.get(robot.robot_mode, '?')}, human authority {robot.alpha:.2f}"
        if robot.fault:
            shown["arm"] += f", {fault_text(robot.fault)}"
    if learner is not None:
        doing = "training" if learner.training else "waiting for episodes"
        shown["learner"] = (
            f"{doing}, {learner.updates_done} updates, {learner.wall_updates_per_s:.0f} /s;"
            f" loss critic {_number(learner.critic_loss)}, actor {_number(learner.actor_loss)}"
        )
        shown["policy wins"] = (
            f"{_share(learner.win_share)} of samples; {_share(learner.win_share_human)} on human steps,"
            f" {_share(learner.win_share_autonomous)} on autonomous ones"
        )
    if status is not None:
        refused = f", {status.policies_rejected} refused" if status.policies_rejected else ""
        shown["policy"] = f"version {status.policy_version}{refused}"
        if not status.lockstep:
            tick = status.wall_tick_us
            shown["real time"] = (
                f"{status.overruns} overruns in {status.ticks} ticks; tick p99 {tick[1]:.0f} us,"
                f" max {tick[3]:.0f} us"
            )
        if status.records_dropped:
            shown["log"] = f"INCOMPLETE: {status.records_dropped} records dropped"
        elif status.episodes_without_motion:
            shown["log"] = (
                f"{status.log_bytes / 1e6:.0f} MB, the quota: {status.episodes_without_motion} episodes without"
                " motion, for learning alone"
            )
    if evaluated or running:
        latest = max(evaluated, default=None)
        parts = []
        if latest is not None:
            value = evaluated[latest]
            parts.append(f"at {latest}: {percent(value['successes'], value['episodes'])}")
        parts += [f"running {name}" for name in running]
        shown["evaluation"] = "; ".join(parts)
    if status is not None and status.waiting_for:
        shown["waiting for"] = status.waiting_for
    return shown


def panel(title: str, shown: dict[str, str], progress: Progress) -> Panel:
    """The view for a terminal."""
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="bold")
    grid.add_column()
    for label, text in shown.items():
        grid.add_row(label, Text(text, style="yellow" if label in ("waiting for", "log") else ""))
    status = progress.status
    done = share(status.env_steps_total, status.env_steps_budget) if status else 0.0
    return Panel(Group(grid, ProgressBar(total=1.0, completed=done)), title=title, title_align="left")


def line(elapsed_s: float, shown: dict[str, str]) -> str:
    """The view in one line, for a file."""
    return f"[{elapsed_s:6.0f} s] " + " | ".join(f"{label}: {text}" for label, text in shown.items())
