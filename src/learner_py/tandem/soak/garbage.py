"""Messages that the controller must refuse: noise, cut ones, lengths that lie, values out of range.

Nothing here may be valid: whatever the controller takes of it is a finding.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.episode_ack_t import episode_ack_t
from tandem_lcm.tandem.episode_request_t import episode_request_t
from tandem_lcm.tandem.impedance_gains_t import impedance_gains_t
from tandem_lcm.tandem.policy_announce_t import policy_announce_t
from tandem_lcm.tandem.teleop_command_t import teleop_command_t

from tandem.wire import CHANNEL_OF, utime

_NOT_FINITE = (math.nan, math.inf, -math.inf)
_LENGTHS = (-(2**31), -1, 0, 2**16, 2**30, 2**31 - 1)
_STRING_LENGTHS = (-(2**31), -1, 0, 2**20, 2**31 - 1)
ELSEWHERE = 1 << 40  # number of an episode that no run reaches


@dataclass(frozen=True)
class Garbage:
    channel: str
    kind: str  # noise | cut | lengths | values
    data: bytes


def garbage(rng: random.Random) -> Garbage:
    """One message of a random channel and kind."""
    kind, make = rng.choice(_KINDS)
    message = rng.choice(_VALID)(rng)
    return Garbage(CHANNEL_OF[type(message)], kind, make(rng, message))


def _noise(rng: random.Random, message: Any) -> bytes:
    """Random bytes, with the type's own fingerprint half of the time."""
    head = message.encode()[:8] if rng.random() < 0.5 else b""
    # shorter than any whole message, so that it can't be one by chance
    return head + rng.randbytes(rng.randrange(8))


def _cut(rng: random.Random, message: Any) -> bytes:
    data = message.encode()
    return data[: rng.randrange(len(data))]


def _lengths(rng: random.Random, message: Any) -> bytes:
    """A valid message in which one length lies; noise for types without one."""
    data = bytearray(message.encode())
    if isinstance(message, teleop_command_t | controller_command_t):
        text = message.operator_id if isinstance(message, teleop_command_t) else message.reason
        place, length = len(data) - len(text.encode()) - 1 - 4, rng.choice(_STRING_LENGTHS)
    elif isinstance(message, policy_announce_t):
        place, length = 8 + 8 + 4, rng.choice(_STRING_LENGTHS)
    elif isinstance(message, episode_request_t):
        place, length = 8 + 8 + 8, rng.choice([n for n in _LENGTHS if n != 0])
    else:
        return _noise(rng, message)
    data[place : place + 4] = struct.pack(">i", length)
    return bytes(data)


def _values(rng: random.Random, message: Any) -> bytes:
    """A well-formed message whose values make no sense."""
    not_finite = rng.choice(_NOT_FINITE)
    if isinstance(message, teleop_command_t):
        what = rng.randrange(4)
        if what < 2:
            axis = rng.randrange(6)
            message.device_twist[axis] = not_finite if what == 0 else rng.choice((-1e9, 1.5, 1e300))
        elif what == 2:
            message.device_gripper = not_finite
        else:
            message.label = rng.choice((-128, -1, 4, 127))
    elif isinstance(message, controller_command_t):
        message.order = rng.choice((-128, -1, 0, 5, 127))
    elif isinstance(message, impedance_gains_t):
        row, column = rng.randrange(6), rng.randrange(6)
        what = rng.randrange(4)
        if what == 0:
            message.stiffness[row][column] = not_finite
        elif what == 1:
            message.stiffness[row][row] = -100.0
        elif what == 2:
            message.stiffness[row][(row + 1) % 6] = 1e6  # not symmetric
        else:
            message.error_clip_low[row] = rng.choice((-0.01, math.nan, math.inf))
    elif isinstance(message, policy_announce_t):
        message.version = rng.choice((-1, 0, -(2**31)))
    elif isinstance(message, episode_request_t):
        message.missing_steps = [rng.choice((-1, 10**9, -(2**31))) for _ in range(rng.randrange(1, 50))]
        message.n_missing = len(message.missing_steps)
    return bytes(message.encode())


def _teleop(rng: random.Random) -> teleop_command_t:
    message = teleop_command_t()
    message.utime, message.episode_answered, message.tick_answered = utime(), ELSEWHERE, -1
    message.device_twist = [rng.uniform(-1.0, 1.0) for _ in range(6)]
    message.engaged = 1
    message.operator_id = "monkey"
    return message


def _order(rng: random.Random) -> controller_command_t:
    message = controller_command_t()
    message.utime, message.order, message.reason = utime(), 0, "monkey"
    return message


def _gains(rng: random.Random) -> impedance_gains_t:
    message = impedance_gains_t()
    message.utime, message.damping_ratio = utime(), 1.0
    for axis in range(6):
        message.stiffness[axis][axis] = 1000.0 if axis < 3 else 100.0
        message.error_clip_low[axis] = message.error_clip_high[axis] = 0.01 if axis < 3 else 0.1
    if not rng.random() < 0.5:
        message.tool_axes = 1
    return message


def _announcement(rng: random.Random) -> policy_announce_t:
    message = policy_announce_t()
    message.utime, message.version = utime(), 0
    message.path, message.sha256 = "bad/nothing.safetensors", "00" * 32
    return message


def _ack(rng: random.Random) -> episode_ack_t:
    message = episode_ack_t()
    message.utime = utime()
    message.episode_acknowledged = rng.choice((-1, -(2**63), ELSEWHERE, 2**63 - 1))
    return message


def _request(rng: random.Random) -> episode_request_t:
    message = episode_request_t()
    message.utime = utime()
    message.episode_requested = rng.choice((-1, ELSEWHERE, 2**63 - 1))
    message.missing_steps = [0, 1, 2]
    message.n_missing = 3
    return message


_VALID: tuple[Callable[[random.Random], Any], ...] = (_teleop, _order, _gains, _announcement, _ack, _request)
_KINDS: tuple[tuple[str, Callable[[random.Random, Any], bytes]], ...] = (
    ("noise", _noise),
    ("cut", _cut),
    ("lengths", _lengths),
    ("values", _values),
)
