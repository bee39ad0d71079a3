"""Listens to a run's three programs, for whoever looks on and for the record: view, TensorBoard, progress.csv."""

import contextlib
import csv
import math
from collections.abc import Callable
from typing import Any

import lcm
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem import summary
from tandem.live_plots import LivePlots
from tandem.live_view import Progress
from tandem.run_clock import Clock
from tandem.run_folder import RunFolder


class Listener:
    """Hears CONTROLLER_STATUS, LEARNER_STATUS, EPISODE_END and ROBOT_STATE.

    @raises RuntimeError when LCM can't open the URL.
    """

    def __init__(
        self, url: str, folder: RunFolder, progress: Progress, clock: Clock, plots: LivePlots
    ) -> None:
        self._folder = folder
        self._progress = progress
        self._clock = clock
        self._plots = plots
        self._lcm = lcm.LCM(url)
        handlers: dict[str, Callable[[bytes], None]] = {
            "CONTROLLER_STATUS": progress.on_status,
            "LEARNER_STATUS": self._on_learner,
            "EPISODE_END": self._on_episode,
            "ROBOT_STATE": self._on_robot,
        }
        for channel, handler in handlers.items():

            def receive(_channel: str, data: bytes, handler: Callable[[bytes], None] = handler) -> None:
                with contextlib.suppress(ValueError):  # somebody else's type on our channel
                    handler(data)

            subscription = self._lcm.subscribe(channel, receive)
            # The arm's state comes thousands of times a second; one now and then is enough to show.
            subscription.set_queue_capacity(1 if channel == "ROBOT_STATE" else 1000)

    def handle(self, seconds: float) -> None:
        """Takes what has come, or comes within this time."""
        with contextlib.suppress(OSError):  # a signal came
            self._lcm.handle_timeout(max(1, int(1000 * seconds)))

    def _on_robot(self, data: bytes) -> None:
        self._progress.robot = data

    def _on_episode(self, data: bytes) -> None:
        end = episode_end_t.decode(data)
        new = end.episode > self._progress.last_episode
        self._progress.on_episode(end)
        if new and end.phase == world_state_t.TRAINING:
            self._plots.episode(end, self._progress)

    def _on_learner(self, data: bytes) -> None:
        before = self._progress.learner
        self._progress.on_learner(data)
        now = self._progress.learner
        if before is not None and before.updates_done == now.updates_done:
            return
        if math.isfinite(now.wall_updates_per_s) and now.wall_updates_per_s > 0:
            rate = self._clock.value["updates_per_s"]
            rate["sum"] += now.wall_updates_per_s
            rate["n"] += 1
        status = self._progress.status
        env_steps = status.env_steps_total if status else 0
        self._plots.learner(env_steps, now)
        self._record(env_steps, now)

    def _record(self, env_steps: int, report: Any) -> None:
        """A row of RUN/progress.csv."""
        new = not self._folder.progress.exists()
        with self._folder.progress.open("a", newline="") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(summary.PROGRESS_COLUMNS)
            writer.writerow(
                [
                    f"{sum(self._clock.value['seconds'].values()):.1f}",
                    env_steps,
                    report.episodes_trained_through,
                    report.updates_done,
                    report.buffer_steps,
                    report.critic_loss,
                    report.actor_loss,
                    report.win_share,
                    report.win_share_human,
                    report.win_share_autonomous,
                    report.wall_updates_per_s,
                ]
            )
