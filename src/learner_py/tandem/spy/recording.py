"""An event log as a source: played, paused, stepped, sought.

The model's clock is that of the log without the pauses between episodes (`IDLE_US`), so that rates stay true and
nobody waits for nothing. In a lockstep log it is the robot's time.
"""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import lcm
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.learner_status_t import learner_status_t

from tandem.log import RawEvent, raw_events
from tandem.log.files import files_of
from tandem.run_folder import RunFolderError, shown
from tandem.spy.model import Batch
from tandem.summary import read_progress

IDLE_US = 1_000_000  # a longer silence is skipped
BACKGROUND_US = (
    3_000_000  # played unseen before the moment that was sought, so that the figures are right there
)
STEP_CHANNEL, STEP_US = "WORLD_STATE", 100_000  # one policy step
SPEEDS = (0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
EVENTS_PER_POLL = 20_000  # a speed that the machine can't keep becomes as fast as it goes
TAIL_BYTES = 1 << 20


class Recording:
    """Events of a log in its order, from any moment on; opens at once, whatever the size."""

    def __init__(self, path: Path) -> None:
        """@raises ValueError with a sentence when it holds no event."""
        self.path = path
        self._log: Any = None
        self._open(0)
        first = self._next()
        if first is None:
            self.close()
            raise ValueError(
                f"{shown(path)} holds no whole event; it is no event log, or nothing was written yet."
            )
        self._first_data = self._next() or first  # SCENARIO is stamped 0 in lockstep
        self.begin_us = min(first.timestamp, self._first_data.timestamp)
        self.end_us = self._find_end()
        self.go_to(self.begin_us)

    def _open(self, number: int) -> None:
        """One of the log's files."""
        self.close()
        self._number = number
        self._log = lcm.EventLog(str(files_of(self.path)[number]), "r")

    def _next(self) -> Any | None:
        """The next event, of the next file where one ends; None at the end of what was written by now."""
        while True:
            position = self._log.tell()
            event = self._log.read_next_event()
            if event is not None:
                return event
            if self._number + 1 >= len(files_of(self.path)):
                self._log.seek(position)  # more may be written
                return None
            self._open(self._number + 1)

    def _find_end(self) -> int:
        """When the last event was written."""
        last = self._first_data.timestamp
        self._open_last(lambda _begin: True)
        self._seek_tail()
        while (event := self._log.read_next_event()) is not None:
            last = event.timestamp
        return int(last)

    def _seek_tail(self) -> None:
        size = files_of(self.path)[self._number].stat().st_size
        self._log.seek(max(0, size - TAIL_BYTES))

    def _open_last(self, wanted: Callable[[int], bool]) -> None:
        """The last file whose first event was written at a time that is wanted; the first one when there is none."""
        for number in reversed(range(len(files_of(self.path)))):
            self._open(number)
            event = self._log.read_next_event()
            self._log.seek(0)
            if event is not None and wanted(event.timestamp):
                return

    def go_to(self, timestamp: int) -> None:
        """The next event is the first that is no older."""
        self._open_last(lambda begin: begin <= timestamp)
        if self._number or timestamp > self.begin_us:
            try:
                self._log.seek_to_timestamp(timestamp)
            except (OSError, SystemError):  # it lies at the end of this file, or between it and the next one
                self._seek_tail()
        self._from = timestamp
        self._ahead: RawEvent | None = None

    def peek(self) -> RawEvent | None:
        """The next event, None at the end (of what was written by now)."""
        while self._ahead is None:
            event = self._next()
            if event is None:
                return None
            if event.timestamp >= self._from:
                self._ahead = RawEvent(event.eventnum, event.timestamp, event.channel, event.data)
        return self._ahead

    def take(self) -> RawEvent | None:
        event, self._ahead = self.peek(), None
        if event is not None:
            self.end_us = max(self.end_us, event.timestamp)
        return event

    def all(self) -> Iterator[RawEvent]:
        """Every event from the first on."""
        return raw_events(self.path)

    def close(self) -> None:
        if self._log is not None:
            self._log.close()


class RecordedSource:
    """Plays a log; `run` is the folder that it lies in, for what only stands in there (progress.csv)."""

    refresh_s = 0.2  # of the view

    def __init__(self, path: Path, run: Path | None) -> None:
        """@raises ValueError with a sentence when the log holds no event."""
        self.title = shown(path)
        self.recording = Recording(path)
        self.paused = False
        self.speed = 1.0
        self.position_us = self.recording.begin_us
        self._skipped_us = 0
        self._last_us: int | None = None  # when the last event came
        self._polled = time.monotonic()
        self._sought = False
        self._steps = 0  # asked for while paused
        self._learner: dict[int, list[Any]] = {}  # episode -> learner_status_t told after it
        for row in read_progress(run / "progress.csv") if run else []:
            self._learner.setdefault(int(row["episode"]), []).append(_learner_status(row))
        self._ends: list[tuple[int, Any]] | None = None
        self._closed = threading.Event()
        self._reader = threading.Thread(target=self._read_ends, name="spy-episodes", daemon=True)
        self._reader.start()

    # ---- what the keys do

    def step(self) -> None:
        """One policy step further, paused."""
        self.paused = True
        self._steps += 1

    def faster(self) -> None:
        self._change_speed(+1)

    def slower(self) -> None:
        self._change_speed(-1)

    def _change_speed(self, by: int) -> None:
        index = SPEEDS.index(self.speed) + by
        self.speed = SPEEDS[min(len(SPEEDS) - 1, max(0, index))]

    def seek(self, to_us: int) -> list[Any]:
        """Goes to a moment of the log; the next poll brings what led to it. Returns the episodes that ended before,
        for a model that begins anew."""
        to_us = min(self.recording.end_us, max(self.recording.begin_us, to_us))
        self.recording.go_to(to_us - BACKGROUND_US)
        self.position_us = to_us
        self._skipped_us, self._last_us, self._sought = 0, None, True
        return [end for at, end in self._ends or [] if at < to_us - BACKGROUND_US]

    def episode_at(self, offset: int) -> int | None:
        """When the episode that many after the present one began, us; None while they are not known."""
        if not self._ends:
            return None
        times = [self.recording.begin_us, *(at + 1 for at, _ in self._ends)]
        now = max((i for i, at in enumerate(times) if at <= self.position_us), default=0)
        return times[min(len(times) - 1, max(0, now + offset))]

    def _read_ends(self) -> None:
        found: list[tuple[int, Any]] = []
        with contextlib.suppress(RunFolderError):  # damaged from there on: what came before counts
            for event in raw_events(self.recording.path, frozenset({"EPISODE_END"})):
                if self._closed.is_set():
                    return
                with contextlib.suppress(ValueError):
                    found.append((event.timestamp, episode_end_t.decode(event.data)))
        self._ends = found

    # ---- playing

    @property
    def ended(self) -> bool:
        return self.recording.peek() is None

    def poll(self) -> Batch:
        """What is due by the wall clock since the last call."""
        now, before = time.monotonic(), self._polled
        self._polled = now
        if self._sought:
            self._sought = False
            return self._play_to(self.position_us)
        if not self.paused:
            return self._play_to(self.position_us + int(1e6 * (now - before) * self.speed))
        if self._steps:
            self._steps -= 1
            return self._play_to(self._next_begin() + STEP_US, until_channel=STEP_CHANNEL)
        return self._play_to(self.position_us)

    def _next_begin(self) -> int:
        """The next event's time when a pause lies before it, else the present."""
        event = self.recording.peek()
        return (
            self.position_us if event is None else max(self.position_us, event.timestamp - self._pause(event))
        )

    def _play_to(self, until_us: int, until_channel: str | None = None) -> Batch:
        """Events up to a moment, or up to the first on a channel. Pauses on the way take no time; when the position
        is to stay, it does."""
        stay = until_us == self.position_us
        batch = Batch(0)
        for _ in range(EVENTS_PER_POLL):
            event = self.recording.peek()
            if event is None:
                until_us = min(until_us, max(self.position_us, self.recording.end_us))
                break
            pause = self._pause(event)
            if event.timestamp - (0 if stay else pause) > until_us:
                break
            self._skipped_us += pause
            until_us += 0 if stay else pause
            self._add(batch, event)
            if event.channel == until_channel:
                until_us = event.timestamp
                break
        else:
            until_us = self._last_us or until_us
        self.position_us = max(self.position_us, until_us)
        batch.now_us = self.position_us - self._skipped_us
        return batch

    def _pause(self, event: RawEvent) -> int:
        """What is left out before this event, us."""
        silence = event.timestamp - self._last_us if self._last_us is not None else 0
        return silence if silence > IDLE_US else 0

    def _add(self, batch: Batch, event: RawEvent) -> None:
        self.recording.take()
        self._last_us = event.timestamp
        times, data = batch.channels.setdefault(event.channel, ([], []))
        times.append(event.timestamp - self._skipped_us)
        data.append(event.data)
        if event.channel == "EPISODE_END" and self._learner:
            batch.learner += self._learner.get(_episode_of(event.data), [])

    def close(self) -> None:
        self._closed.set()
        self._reader.join()
        self.recording.close()


def whole(recording: Recording) -> Iterator[Batch]:
    """The log from end to end, as fast as it can be read, its pauses left out."""
    batch, skipped, last = Batch(0), 0, recording.begin_us
    for n, event in enumerate(recording.all(), 1):
        if event.timestamp - last > IDLE_US:
            skipped += event.timestamp - last
        last = event.timestamp
        times, data = batch.channels.setdefault(event.channel, ([], []))
        batch.now_us = last - skipped
        times.append(batch.now_us)
        data.append(event.data)
        if n % 4096 == 0:
            yield batch
            batch = Batch(batch.now_us)
    yield batch


def _episode_of(data: bytes) -> int:
    try:
        return int(episode_end_t.decode(data).episode)
    except ValueError:
        return -1


def _learner_status(row: dict[str, float]) -> Any:
    """A line of progress.csv as the message that it was."""
    status = learner_status_t()
    status.episodes_trained_through = int(row["episode"])
    status.updates_done = int(row["updates"])
    status.buffer_steps = int(row["buffer_steps"])
    for name in ("critic_loss", "actor_loss", "win_share", "win_share_human", "win_share_autonomous"):
        setattr(status, name, row[name])
    status.wall_updates_per_s = row["updates_per_s"]
    return status
