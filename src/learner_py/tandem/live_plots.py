"""RUN/tensorboard/: the run's figures as TensorBoard event files, written while it goes. x axis: env steps.

    tensorboard --logdir runs      (or any other reader of event files)

A run never waits for them and never ends by them: what can't be written is counted and told once.
"""

import contextlib
import math
import os
import socket
import struct
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

from tandem.live_view import Progress
from tandem.statistics import share


class LivePlots:
    """Scalars under `success/`, `human/`, `force/`, `episode/`, `losses/`, `wins/` and `learner/`.

    A call that goes on with a run writes another file beside the first; readers join them by env steps.
    """

    def __init__(self, folder: Path, say: Callable[[str], None], evaluated: Mapping[int, Any]) -> None:
        """evaluated: env_steps -> results that an earlier call has written."""
        self.folder = folder
        self.failures = 0
        self._say = say
        self._written = set(evaluated)
        self._file: IO[bytes] | None = None
        self._files = 0

    def learner(self, env_steps: int, status: Any) -> None:
        """A LEARNER_STATUS that tells of new updates."""
        self._write(
            env_steps,
            {
                "losses/critic": status.critic_loss,
                "losses/actor": status.actor_loss,
                "wins/all": status.win_share,
                "wins/human_steps": status.win_share_human,
                "wins/autonomous_steps": status.win_share_autonomous,
                "learner/updates": status.updates_done,
                "learner/updates_per_s": status.wall_updates_per_s,
                "learner/buffer_steps": status.buffer_steps,
            },
        )

    def episode(self, end: Any, progress: Progress) -> None:
        """A training episode that has ended; `progress` has it already."""
        self._write(
            end.env_steps_total,
            {
                "success/recent_episodes": share(progress.successes, len(progress.recent)),
                "human/share_recent": progress.human_share,
                "human/takeovers": end.n_takeovers,
                "force/peak_N": end.force_peak,
                "force/filtered_peak_N": end.force_filtered_peak,
                "episode/steps": end.n_steps,
                "episode/policy_version": end.policy_version,
            },
        )

    def evaluations(self, evaluated: Mapping[int, Mapping[str, Any]]) -> None:
        """Results of checkpoints by env steps; each is written once."""
        for env_steps in sorted(set(evaluated) - self._written):
            self._written.add(env_steps)
            value = evaluated[env_steps]
            scalars = {"success/evaluation": share(value["successes"], value["episodes"])}
            if value.get("steps_mean") is not None:
                scalars["episode/steps_evaluation"] = value["steps_mean"]
            self._write(env_steps, scalars)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            if self._file is not None:
                self._file.close()
        self._file = None

    def _write(self, env_steps: int, scalars: Mapping[str, float]) -> None:
        known = {tag: float(value) for tag, value in scalars.items() if math.isfinite(value)}
        if not known:
            return
        try:
            # Not tensorboardX's SummaryWriter: its thread dies of a full disk, and then its queue blocks us; nor its
            # RecordWriter, which waits for the disk at every flush.
            from tensorboardX.proto.event_pb2 import Event
            from tensorboardX.proto.summary_pb2 import Summary

            values = [Summary.Value(tag=tag, simple_value=value) for tag, value in known.items()]
            event = Event(wall_time=time.time(), step=env_steps, summary=Summary(value=values))
            if self._file is None:
                self._file = self._open()
                self._file.write(_record(Event(wall_time=time.time(), file_version="brain.Event:2")))
            self._file.write(_record(event))
        except Exception as error:  # whatever it is: plots never end a run
            self.failures += 1
            self.close()  # a torn file is left as it is; the next one goes on
            if self.failures == 1:
                self._say(f"{self.folder} can't be written ({error}): live plots have gaps, the run goes on.")

    def _open(self) -> IO[bytes]:
        self.folder.mkdir(parents=True, exist_ok=True)
        self._files += 1
        name = f"events.out.tfevents.{int(time.time())}.{socket.gethostname()}.{os.getpid()}.{self._files}"
        return (self.folder / name).open("wb", buffering=0)


def _record(event: Any) -> bytes:
    """An event as it lies in the file (TFRecord): length, its checksum, bytes, their checksum."""
    from tensorboardX.record_writer import masked_crc32c

    data = event.SerializeToString()
    head = struct.pack("<Q", len(data))
    return head + struct.pack("<I", masked_crc32c(head)) + data + struct.pack("<I", masked_crc32c(data))
