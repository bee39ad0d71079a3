"""All that the pages show, fed by a source in batches of undecoded messages."""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from tandem_lcm.tandem.episode_end_t import episode_end_t

from tandem.faults import fault_text
from tandem.live_view import Progress
from tandem.scenario import Scenario
from tandem.spy import expected
from tandem.spy.channel import DECODED, Channel, Row
from tandem.spy.fields import FieldHistory
from tandem.words import OUTCOMES, PHASES

HISTORY = 120  # values of α, force, losses
EVENTS = 200
SAMPLED = 20  # messages of a batch that are decoded for its sparklines


@dataclass
class Batch:
    """What came since the last one: channel -> times of receipt (us, the source's clock) and messages."""

    now_us: int
    channels: dict[str, tuple[list[int], list[bytes]]] = field(default_factory=dict)
    learner: list[Any] = field(default_factory=list)  # learner_status_t from elsewhere than a channel
    live: bool = False  # the clock is the machine's monotonic one, as that of `utime` in real time


@dataclass(frozen=True)
class Event:
    """Something that happened, for the event track."""

    at_s: float  # on the source's clock, since it began
    text: str
    style: str = ""


class Series:
    """A named figure's recent values."""

    def __init__(self) -> None:
        self._values: dict[str, deque[float]] = {}

    def add(self, **values: float) -> None:
        for name, value in values.items():
            self._values.setdefault(name, deque(maxlen=HISTORY)).append(value)

    def __getitem__(self, name: str) -> deque[float]:
        return self._values.get(name, deque())


class Model:
    """Pure state: no terminal, no LCM, no clock of its own."""

    def __init__(self, scenario: Scenario | None = None, robot_time: bool | None = None) -> None:
        """robot_time: see expected.rates; None = as CONTROLLER_STATUS says."""
        self.scenario = scenario
        self.channels: dict[str, Channel] = {}
        self.now_us = 0
        self.progress = Progress()
        self.faults: deque[Any] = deque(maxlen=5)  # controller_fault_t
        self.announced: Any = None  # policy_announce_t
        self.acknowledged: Any = None  # policy_ack_t
        self.refused = 0  # policies
        self.series = Series()
        self.events: deque[Event] = deque(maxlen=EVENTS)
        self.chosen: str | None = None  # channel whose members are shown
        self.fields = FieldHistory()
        self._robot_time = robot_time
        self._live = False
        self._began_us: int | None = None
        self._human = False
        self._version = 0
        self._decoders: dict[str, Callable[[Any], None]] = {
            "ROBOT_STATE": self._on_robot,
            "CONTROLLER_STATUS": self._on_status,
            "LEARNER_STATUS": self._on_learner,
            "EPISODE_END": self._on_episode,
            "POLICY_ANNOUNCE": self._on_announce,
            "POLICY_ACK": self._on_ack,
            "CONTROLLER_FAULT": self._on_fault,
        }

    # ---- feeding

    def take(self, batch: Batch, decoded: int | None = DECODED) -> None:
        """decoded: see Channel.take."""
        self.now_us, self._live = batch.now_us, batch.live
        for name, (times, data) in batch.channels.items():
            if self._began_us is None:
                self._began_us = times[0]
            channel = self.channels.setdefault(name, Channel(name))
            good = channel.take(times, data, decoded, batch.live)
            if good and channel.layout is not None:
                self._show(name, channel, good)
        for status in batch.learner:
            self._on_learner(status)

    def _show(self, name: str, channel: Channel, good: list[bytes]) -> None:
        assert channel.layout is not None
        decode = channel.layout.decode
        if handler := self._decoders.get(name):
            # every message counts, but of the arm's states some are enough
            for data in _sample(good) if name == "ROBOT_STATE" else good:
                if (message := decode(data)) is not None:
                    handler(message)
        if name == self.chosen:
            for data in _sample(good):
                if (message := decode(data)) is not None:
                    self.fields.take(message)

    def choose(self, channel: str | None) -> None:
        """Whose members are shown from now on."""
        if channel != self.chosen:
            self.chosen, self.fields = channel, FieldHistory()
            if channel in self.channels and (message := self.channels[channel].decode_latest()) is not None:
                self.fields.take(message)

    # ---- what is shown

    def rows(self) -> list[Row]:
        """The table of channels, by name."""
        rates = expected.rates(self.scenario, self.robot_time, self._live)
        return [channel.row(self.now_us, rates.get(name)) for name, channel in sorted(self.channels.items())]

    def latest(self, channel: str) -> Any | None:
        """The last message of a channel, decoded now."""
        found = self.channels.get(channel)
        return None if found is None else found.decode_latest()

    @property
    def robot_time(self) -> bool:
        if self._robot_time is not None:
            return self._robot_time
        status = self.progress.status
        return status is not None and not status.lockstep

    @property
    def elapsed_s(self) -> float:
        return 0.0 if self._began_us is None else (self.now_us - self._began_us) / 1e6

    # ---- messages whose meaning is shown

    def _tell(self, text: str, style: str = "") -> None:
        self.events.append(Event(self.elapsed_s, text, style))

    def _on_robot(self, robot: Any) -> None:
        self.progress.robot = self.channels["ROBOT_STATE"].latest or b""
        force = sum(value * value for value in robot.F_ext_W[:3]) ** 0.5
        self.series.add(alpha=robot.alpha, force=force, gripper=robot.gripper_width)
        human = robot.alpha >= 0.5
        if human != self._human:
            self._human = human
            self._tell("the human has the arm" if human else "the policy has the arm", "cyan")

    def _on_status(self, status: Any) -> None:
        self.progress.take_status(status)
        self._in_force(status.policy_version)

    def _on_learner(self, status: Any) -> None:
        before = self.progress.learner
        self.progress.learner = status
        if before is None or before.updates_done != status.updates_done:
            self.series.add(
                critic_loss=status.critic_loss,
                actor_loss=status.actor_loss,
                win_share=status.win_share,
                win_share_human=status.win_share_human,
                win_share_autonomous=status.win_share_autonomous,
                updates_per_s=status.wall_updates_per_s,
            )

    def _on_episode(self, end: Any) -> None:
        if end.episode <= self.progress.last_episode:
            return
        self.recall([end])
        outcome = OUTCOMES.get(end.outcome, "?")
        phase = PHASES.get(end.phase, "?")
        self._tell(
            f"episode {end.episode} ({phase}): {outcome}, {end.n_steps} steps,"
            f" {end.n_intervention_steps} by the human, peak {end.force_peak:.0f} N",
            "green" if end.outcome == episode_end_t.SUCCESS else "yellow",
        )
        self._in_force(end.policy_version)

    def recall(self, ends: Iterable[Any]) -> None:
        """Episodes that ended before what is shown."""
        for end in ends:
            self.progress.on_episode(end)

    def _on_announce(self, announce: Any) -> None:
        if self.announced is None or announce.version > self.announced.version:
            self.announced = announce

    def _on_ack(self, ack: Any) -> None:
        self.acknowledged = ack
        if not ack.accepted:
            self.refused += 1
            self._tell(f"policy {ack.version_answered} refused: {ack.reason}", "bold red")

    def _in_force(self, version: int) -> None:
        if version != self._version:
            self._version = version
            self._tell(f"policy {version} is in force")

    def _on_fault(self, fault: Any) -> None:
        self.faults.append(fault)
        place = "between episodes" if fault.episode < 0 else f"in episode {fault.episode}"
        self._tell(f"fault {place}: {fault.sentence or fault_text(fault.fault)}", "bold red")


def _sample(data: list[bytes]) -> list[bytes]:
    """At most SAMPLED of them, evenly, the last one included."""
    stride = -(-len(data) // SAMPLED)
    return data[::-1][::stride][::-1]
