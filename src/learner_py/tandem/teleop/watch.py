"""What the controller tells, for the person at the controls."""

import math
import time
from collections.abc import Callable
from typing import Any

from tandem_lcm.tandem.controller_fault_t import controller_fault_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.robot_state_t import robot_state_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.faults import fault_text
from tandem.wire import Wire

SILENCE_S = 1.0  # the status comes ten times a second


class Watch:
    """The latest message of each kind."""

    def __init__(self, wire: Wire, on_status: Callable[[Any], None]) -> None:
        self.status: Any = None  # controller_status_t
        self.robot: Any = None  # robot_state_t
        self.world: Any = None  # world_state_t
        self._fault: Any = None  # controller_fault_t
        self._status_at = -math.inf
        self._on_status = on_status
        wire.subscribe(controller_status_t, self._hear_status)
        wire.subscribe(robot_state_t, lambda message, _: setattr(self, "robot", message))
        wire.subscribe(world_state_t, lambda message, _: setattr(self, "world", message))
        wire.subscribe(controller_fault_t, lambda message, _: setattr(self, "_fault", message))

    def _hear_status(self, status: Any, _data: bytes) -> None:
        self.status, self._status_at = status, time.monotonic()
        self._on_status(status)

    @property
    def silent(self) -> bool:
        """No controller, or none any more."""
        return time.monotonic() - self._status_at > SILENCE_S

    @property
    def running(self) -> bool:
        """An episode is under way."""
        return not self.silent and self.status.state == controller_status_t.RUNNING

    @property
    def halted(self) -> bool:
        """A fault is latched."""
        return not self.silent and self.status.state == controller_status_t.HALTED

    @property
    def gripper_width(self) -> float:
        """m; 0 before it is known."""
        return 0.0 if self.robot is None else float(self.robot.gripper_width)

    def fault(self) -> str:
        """Why the arm stands still, empty when no fault is latched."""
        code = self.status.fault if self.status is not None else 0
        if code == 0:
            return ""
        if self._fault is not None and self._fault.fault == code and self._fault.sentence:
            return str(self._fault.sentence)
        return fault_text(code)


def object_in_goal(world: Any) -> tuple[list[float], float, float]:
    """Where the object in hand is, seen from the goal: position (m, goal axes), turn about the goal's z and tilt (rad).

    All zero when it sits in the goal's mouth; z is the height above it.
    """
    goal_from_base = _conjugate(world.q_WG)
    position = _rotate(goal_from_base, [o - g for o, g in zip(world.p_WO, world.p_WG, strict=True)])
    # The object's z points into the goal: turned half about its x axis, it would look like the goal.
    upright = _multiply(world.q_WO, (0.0, 1.0, 0.0, 0.0))
    w, x, y, z = _multiply(goal_from_base, upright)
    sine = math.hypot(x, y, z)
    scale = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, abs(w)) / sine
    scale = math.copysign(scale, w) if w else scale
    return position, scale * z, math.hypot(scale * x, scale * y)


def _conjugate(q: Any) -> tuple[float, float, float, float]:
    return (q[0], -q[1], -q[2], -q[3])


def _multiply(a: Any, b: Any) -> tuple[float, float, float, float]:
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def _rotate(q: Any, v: list[float]) -> list[float]:
    return list(_multiply(_multiply(q, (0.0, *v)), _conjugate(q))[1:])
