"""Orders to the controller (CONTROLLER_COMMAND) that are sent until its status says that they were carried out."""

import math
from dataclasses import dataclass
from typing import Any

from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.controller_status_t import controller_status_t

from tandem.wire import utime

SILENCE_S = 1.0  # a controller that tells nothing for so long (it tells ten times a second) has ended
ENDED = (controller_status_t.FINISHED, controller_status_t.FAULTED)

_AGAIN_S = {
    controller_command_t.ESTOP: 0.05,
    controller_command_t.STOP: 0.2,
    # These two mean something else when they come once more: only when the status has had time to tell.
    controller_command_t.RECOVER: 0.7,
    controller_command_t.DISCARD: 0.7,
}


@dataclass
class Order:
    """One order. `before` is the controller's status when it was given, None when it has not been heard yet."""

    order: int  # controller_command_t.STOP ...
    reason: str
    before: Any  # controller_status_t
    given: float  # s, monotonic, when it was given
    _sent: float = -math.inf

    def message(self) -> controller_command_t:
        message = controller_command_t()
        message.utime = utime()
        message.order = self.order
        message.reason = self.reason
        return message

    def due(self, now: float) -> bool:
        """True when it is time to send it (again); counts as sent then."""
        if now - self._sent < _AGAIN_S[self.order]:
            return False
        self._sent = now
        return True

    def done(self, status: Any) -> bool:
        """True when the status says that it was carried out."""
        if status is None:
            return False
        if self.order == controller_command_t.ESTOP:
            return status.state in (controller_status_t.HALTED, controller_status_t.FAULTED)
        if self.order == controller_command_t.RECOVER:
            return status.state != controller_status_t.HALTED
        if self.order == controller_command_t.DISCARD:
            return self.before is not None and (
                status.episode != self.before.episode or status.state != controller_status_t.RUNNING
            )
        return status.state in ENDED
