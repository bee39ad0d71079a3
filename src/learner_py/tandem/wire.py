"""LCM in Python: which type travels on which channel, and how to send and receive it.

Every message type has exactly one channel (`CHANNELS`), so a program names only the type:

    wire = Wire(url)
    wire.subscribe(episode_end_t, lambda end, data: ...)   # data: the bytes as received
    wire.publish(acknowledgement)
    wire.handle(timeout_s=0.1)

Messages that do not decode are counted and dropped, never thrown. ttl 0 unless the URL says otherwise: nothing leaves
this machine.
"""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import lcm
from tandem_lcm.tandem.action_chunk_t import action_chunk_t
from tandem_lcm.tandem.camera_frame_t import camera_frame_t
from tandem_lcm.tandem.control_tick_t import control_tick_t
from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.controller_fault_t import controller_fault_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_ack_t import episode_ack_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.episode_request_t import episode_request_t
from tandem_lcm.tandem.episode_step_t import episode_step_t
from tandem_lcm.tandem.impedance_gains_t import impedance_gains_t
from tandem_lcm.tandem.learner_status_t import learner_status_t
from tandem_lcm.tandem.policy_ack_t import policy_ack_t
from tandem_lcm.tandem.policy_announce_t import policy_announce_t
from tandem_lcm.tandem.provenance_t import provenance_t
from tandem_lcm.tandem.robot_state_t import robot_state_t
from tandem_lcm.tandem.scenario_t import scenario_t
from tandem_lcm.tandem.teleop_command_t import teleop_command_t
from tandem_lcm.tandem.world_state_t import world_state_t

DEFAULT_URL = "udpm://239.255.76.67:7667?ttl=0"

# channel -> type; SCENARIO, PROVENANCE and CONTROL_TICK are only found in event logs
CHANNELS: dict[str, type] = {
    "SCENARIO": scenario_t,
    "PROVENANCE": provenance_t,
    "CONTROL_TICK": control_tick_t,
    "ROBOT_STATE": robot_state_t,
    "WORLD_STATE": world_state_t,
    "TELEOP_COMMAND": teleop_command_t,
    "ACTION_CHUNK": action_chunk_t,
    "EPISODE_STEP": episode_step_t,
    "EPISODE_END": episode_end_t,
    "EPISODE_ACK": episode_ack_t,
    "EPISODE_REQUEST": episode_request_t,
    "POLICY_ANNOUNCE": policy_announce_t,
    "POLICY_ACK": policy_ack_t,
    "CAMERA_WRIST": camera_frame_t,
    "CONTROLLER_STATUS": controller_status_t,
    "CONTROLLER_COMMAND": controller_command_t,
    "CONTROLLER_FAULT": controller_fault_t,
    "IMPEDANCE_GAINS": impedance_gains_t,
    "LEARNER_STATUS": learner_status_t,
}
CHANNEL_OF: dict[type, str] = {message_type: channel for channel, message_type in CHANNELS.items()}

Message = TypeVar("Message")


class Member(NamedTuple):
    """One member of a message type, as its .lcm file declares it."""

    name: str
    kind: str  # double, string ...; another message type with its package
    dimensions: tuple[int | str, ...]  # a text names the member that tells the length; empty: no array


def members(message_type: Any) -> list[Member]:
    """All of them, in the order of the bytes."""
    facts = (message_type.__slots__, message_type.__typenames__, message_type.__dimensions__)
    return [Member(name, kind, tuple(sizes or ())) for name, kind, sizes in zip(*facts, strict=True)]


def utime() -> int:
    """Now on the monotonic clock, us."""
    return time.monotonic_ns() // 1000


def default_url() -> str:
    """LCM_DEFAULT_URL, else LCM's own group and port with ttl 0."""
    return os.environ.get("LCM_DEFAULT_URL") or DEFAULT_URL


def decode(channel: str, data: bytes) -> Any | None:
    """The typed message of a channel, or None when the channel is not ours or the bytes are not of its type."""
    message_type: Any = CHANNELS.get(channel)
    if message_type is None:
        return None
    try:
        return message_type.decode(data)
    except (
        Exception
    ):  # struct.error, ValueError, UnicodeDecodeError, MemoryError: all mean "not this message"
        return None


class Wire:
    """One LCM connection. Call `handle` from one thread; `publish` from any."""

    def __init__(self, url: str | None = None) -> None:
        self.url = url or default_url()
        self.n_malformed = 0
        try:
            self._lcm = lcm.LCM(self.url)
        except RuntimeError as error:
            raise RuntimeError(
                f"LCM does not open '{self.url}': {error}. It needs a multicast route; on one machine: "
                "ip link set lo multicast on; ip route add 239.255.76.67 dev lo"
            ) from error

    def publish(self, message: Any) -> None:
        """Sends the message on the channel of its type."""
        self._lcm.publish(CHANNEL_OF[type(message)], message.encode())

    def fileno(self) -> int:
        """Readable when there is something to handle; for select."""
        return int(self._lcm.fileno())

    def subscribe(self, message_type: type[Message], handler: Callable[[Message, bytes], None]) -> None:
        """Calls handler(message, data) from `handle`. The queue of EPISODE_* channels is unlimited: a burst of steps
        at the end of an episode must wait for us, not push out its own beginning."""
        channel = CHANNEL_OF[message_type]

        def receive(channel: str, data: bytes) -> None:
            message = decode(channel, data)
            if message is None:
                self.n_malformed += 1
            else:
                handler(message, data)

        subscription = self._lcm.subscribe(channel, receive)
        subscription.set_queue_capacity(0 if channel.startswith("EPISODE_") else 30)

    def subscribe_raw(self, pattern: str, handler: Callable[[str, bytes], None]) -> None:
        """Calls handler(channel, data) for every message on channels that match a regular expression, not decoded.
        The queue is unlimited: call `handle_one` all the time, or it grows."""
        self._lcm.subscribe(pattern, handler).set_queue_capacity(0)

    def handle_one(self, timeout_s: float) -> bool:
        """Waits up to timeout_s for a message and handles it; False when none came. The cheapest way to hear many."""
        return bool(self._lcm.handle_timeout(max(1, int(1000 * timeout_s))))

    def handle(self, timeout_s: float) -> int:
        """Waits up to timeout_s for a message, then handles all that are there. Returns how many."""
        n = 0
        while select.select([self._lcm.fileno()], [], [], timeout_s if n == 0 else 0.0)[0]:
            self._lcm.handle()
            n += 1
        return n
