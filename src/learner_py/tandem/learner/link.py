"""The learner's side of the wire, in a thread of its own, so that nothing waits for a gradient.

In:  EPISODE_STEP, EPISODE_END -> whole episodes (acknowledged at once; missing steps are requested every half second)
     POLICY_ACK, CONTROLLER_STATUS
Out: EPISODE_ACK, EPISODE_REQUEST; POLICY_ANNOUNCE every half second until acknowledged; LEARNER_STATUS when told, and
     every 0.8 s without being told
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_ack_t import episode_ack_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.episode_request_t import episode_request_t
from tandem_lcm.tandem.episode_step_t import episode_step_t
from tandem_lcm.tandem.learner_status_t import learner_status_t
from tandem_lcm.tandem.policy_ack_t import policy_ack_t
from tandem_lcm.tandem.policy_announce_t import policy_announce_t

from tandem.learner.episode import Episode, EpisodeAssembler
from tandem.wire import Wire, utime

RESEND_S = 0.5
HEARTBEAT_S = 0.8
# An episode that the controller believes delivered but that we lost in a crash is asked for after this long.
LOST_EPISODE_S = 2.0
# A refusal may be meant for a file that somebody else announced under our number; ours is announced again, and is at
# fault when it is refused so many times.
N_REFUSALS = 3


@dataclass
class _Announcement:
    message: policy_announce_t
    acknowledged: bool = False
    refusals: int = 0
    sent: float = -1e9  # monotonic s


class Link:
    """Shared between the training thread and its own; every public member may be used from the training thread."""

    def __init__(self, url: str | None, keep_announcements: int, say: Callable[[str], None]) -> None:
        self.wire = Wire(url)
        self.refusal: str | None = None  # a sentence when the run can't go on
        self.status: controller_status_t | None = None  # the controller's latest
        self._heard = time.monotonic()  # when it came
        self._keep = keep_announcements
        self._say = say
        self._lock = threading.Condition()
        self._assembler = EpisodeAssembler()
        self._episodes: dict[int, Episode] = {}  # whole, not yet taken
        self._digests: dict[int, str] = {}  # of all whole episodes ever
        self._announcements: dict[int, _Announcement] = {}
        self._requested: dict[int, float] = {}  # when, monotonic s
        self._report = learner_status_t()
        self._report_sent = -1e9
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="link", daemon=True)
        self.wire.subscribe(episode_step_t, lambda step, data: self._assembler.add_step(step, data))
        self.wire.subscribe(episode_end_t, self._on_end)
        self.wire.subscribe(policy_ack_t, self._on_policy_ack)
        self.wire.subscribe(controller_status_t, self._on_status)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()

    # ---- for the training thread

    @property
    def silence_s(self) -> float:
        """Since the last CONTROLLER_STATUS, or since the start when there was none."""
        return time.monotonic() - self._heard

    def offer(self, episode: Episode) -> None:
        """A whole episode, from the log or the wire."""
        with self._lock:
            if episode.number in self._digests:
                self._agrees(episode.end)
            else:
                self._digests[episode.number] = episode.end.steps_sha256
                self._episodes[episode.number] = episode
                self._lock.notify_all()

    def take(self, number: int, timeout_s: float) -> Episode | None:
        """The episode, waiting for it up to timeout_s; None when it has not come."""
        with self._lock:
            self._lock.wait_for(lambda: number in self._episodes or self.refusal is not None, timeout_s)
            return self._episodes.pop(number, None)

    def announce(self, message: policy_announce_t) -> None:
        """Announces a policy at once and then until it is acknowledged; old announcements fall out."""
        with self._lock:
            self._announcements[message.version] = _Announcement(message)
            for version in sorted(self._announcements)[: -self._keep]:
                del self._announcements[version]
            self._send_announcements()

    def report(self, **values: Any) -> None:
        """Sends LEARNER_STATUS with these members changed."""
        with self._lock:
            for name, value in values.items():
                setattr(self._report, name, value)
            self._send_report()

    # ---- the thread

    def _serve(self) -> None:
        while not self._ended.is_set():
            self.wire.handle(timeout_s=0.05)
            with self._lock:
                now = time.monotonic()
                for number in self._assembler.ended():
                    self._request(number, RESEND_S)
                # the controller is past an episode that we know nothing of: its acknowledgement outlived our memory
                running = self.status.episode if self.status is not None else 0
                known = max([running, *(number + 1 for number in self._digests)])
                for number in range(known):
                    if number not in self._digests and number not in self._assembler.ended():
                        self._requested.setdefault(number, now + LOST_EPISODE_S - RESEND_S)
                        self._request(number, RESEND_S)
                self._send_announcements()
                if now - self._report_sent > HEARTBEAT_S:
                    self._send_report()

    def _on_end(self, end: episode_end_t, _data: bytes) -> None:
        with self._lock:
            number = end.episode
            if number not in self._digests:
                self._assembler.add_end(end)
                try:
                    episode = self._assembler.take(number)
                except ValueError as error:
                    self._refuse(str(error))
                    return
                if episode is None:
                    self._request(number, RESEND_S)
                    return
                self.offer(episode)
            elif not self._agrees(end):
                return
            acknowledgement = episode_ack_t()
            acknowledgement.utime = utime()
            acknowledgement.episode_acknowledged = number
            self.wire.publish(acknowledgement)

    def _agrees(self, end: episode_end_t) -> bool:
        """Is this the episode that we know under its number? Whether log or wire came first does not matter."""
        known = self._digests[end.episode]
        if known != end.steps_sha256:
            self._refuse(
                f"Episode {end.episode} on the wire is not the one in the log (digests {known[:12]} and "
                f"{end.steps_sha256[:12]}). Controller and learner must use the same run folder."
            )
        return known == end.steps_sha256

    def _request(self, number: int, every_s: float) -> None:
        now = time.monotonic()
        if now - self._requested.get(number, -1e9) < every_s:
            return
        self._requested[number] = now
        request = episode_request_t()
        request.utime = utime()
        request.episode_requested = number
        if number in self._assembler.ended():
            request.missing_steps = self._assembler.missing_steps(number)
        request.n_missing = len(request.missing_steps)
        self.wire.publish(request)
        what = f"{request.n_missing} steps" if request.n_missing else "all steps"
        self._say(f"episode {number}: asking for {what} again")

    def _on_policy_ack(self, ack: policy_ack_t, _data: bytes) -> None:
        with self._lock:
            announcement = self._announcements.get(ack.version_answered)
            if announcement is None:
                return
            announcement.acknowledged = bool(ack.accepted)
            if ack.accepted:
                announcement.refusals = 0
                return
            announcement.refusals += 1
            announcement.sent = -1e9  # at once
            if announcement.refusals >= N_REFUSALS:
                self._refuse(
                    f"The controller refuses policy {ack.version_answered} ({announcement.message.path}): {ack.reason}"
                )

    def _on_status(self, status: controller_status_t, _data: bytes) -> None:
        with self._lock:
            if self.status is not None and self.status.wall_instance != status.wall_instance:
                self._say("a new controller is there; announcing the last policies again")
                for announcement in self._announcements.values():
                    announcement.acknowledged = False
            self.status = status
            self._heard = time.monotonic()

    def _refuse(self, sentence: str) -> None:
        if self.refusal is None:
            self.refusal = sentence
            self._lock.notify_all()

    def _send_announcements(self) -> None:
        now = time.monotonic()
        for _, announcement in sorted(self._announcements.items()):
            if not announcement.acknowledged and now - announcement.sent >= RESEND_S:
                announcement.sent = now
                announcement.message.utime = utime()
                self.wire.publish(announcement.message)

    def _send_report(self) -> None:
        self._report.utime = utime()
        self._report_sent = time.monotonic()
        self.wire.publish(self._report)
