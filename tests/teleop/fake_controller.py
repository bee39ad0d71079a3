"""Stand-in for tandem_controller on the wire: tells its status, takes commands, judges nothing."""

import threading
import time
from typing import Any

from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.impedance_gains_t import impedance_gains_t
from tandem_lcm.tandem.robot_state_t import robot_state_t
from tandem_lcm.tandem.teleop_command_t import teleop_command_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.wire import Wire

ESTOP_FAULT = 23


class FakeController:
    """A context; runs in a thread. What it heard lies in `teleop` (with arrival times), `orders`, `gains`."""

    def __init__(self, url: str, obeys: bool = True, takes_gains: bool = True) -> None:
        self.url = url
        self.teleop: list[tuple[float, Any]] = []
        self.orders: list[int] = []
        self.gains: list[Any] = []
        self.status = controller_status_t()
        self.status.state = controller_status_t.RUNNING
        self.status.phase = world_state_t.DEMONSTRATION
        self.status.episode = 5
        self._obeys, self._takes_gains = obeys, takes_gains
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> "FakeController":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        wire = Wire(self.url)
        wire.subscribe(teleop_command_t, self._hear_teleop)
        wire.subscribe(controller_command_t, self._hear_order)
        wire.subscribe(impedance_gains_t, self._hear_gains)
        robot, world = robot_state_t(), world_state_t()
        robot.force_bound_W = [20.0] * 6
        robot.gripper_width = 0.02
        world.q_WG, world.q_WO = [1.0, 0, 0, 0], [0, 1.0, 0, 0]
        world.p_WO = [0.0, 0.0, 0.0123]
        next_status = 0.0
        while not self._stop.is_set():
            wire.handle(0.005)
            if (now := time.monotonic()) >= next_status:
                next_status = now + 0.05
                wire.publish(self.status)
                wire.publish(robot)
                wire.publish(world)
                if self.status.state == controller_status_t.FINISHED:
                    return

    def _hear_teleop(self, command: Any, _data: bytes) -> None:
        self.teleop.append((time.monotonic(), command))
        if command.label and command.episode_answered == self.status.episode:
            self.status.episode += 1

    def _hear_order(self, command: Any, _data: bytes) -> None:
        self.orders.append(command.order)
        if not self._obeys:
            return
        status = self.status
        if command.order == controller_command_t.ESTOP:
            status.state, status.fault = controller_status_t.HALTED, ESTOP_FAULT
        elif command.order == controller_command_t.RECOVER:
            status.state, status.fault, status.episode = controller_status_t.RUNNING, 0, status.episode + 1
        elif command.order == controller_command_t.DISCARD:
            status.episode += 1
        elif command.order == controller_command_t.STOP:
            status.state = controller_status_t.FINISHED

    def _hear_gains(self, gains: Any, _data: bytes) -> None:
        self.gains.append(gains)
        if self._takes_gains:
            self.status.gains_accepted += 1
        else:
            self.status.gains_rejected += 1
            self.status.last_rejection = "stiffness is too large"
