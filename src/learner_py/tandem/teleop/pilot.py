"""What the person wants, as it goes into TELEOP_COMMAND."""

from collections.abc import Sequence

from tandem_lcm.tandem.teleop_command_t import teleop_command_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.teleop.motion import FASTEST, SLOWEST, SPEED_STEP
from tandem.wire import utime

LABEL_MESSAGES = 10  # a label goes out in so many messages: the loss of some does not matter
OPEN_WIDTH_M = 0.07  # wider than this the gripper holds nothing

VERDICTS = {
    teleop_command_t.LABEL_SUCCESS: "success",
    teleop_command_t.LABEL_FAIL: "failure",
    teleop_command_t.LABEL_DISCARD: "discard",
}


class Pilot:
    """Authority, gripper, speed and verdict. Starts with the hands off."""

    def __init__(self, operator_id: str) -> None:
        self.operator_id = operator_id
        self.engaged = False
        self.gripper = 1.0  # -1 open, 1 closed
        self.speed = 0.5  # share of the task's limit per step
        self._label = teleop_command_t.LABEL_NONE
        self._label_left = 0  # messages that still carry it
        self._episode = -1

    def engage(self, gripper_width: float) -> None:
        """Takes the arm; the gripper stays as it is."""
        if not self.engaged:
            self.gripper = -1.0 if gripper_width > OPEN_WIDTH_M else 1.0
        self.engaged = True

    def release(self) -> None:
        self.engaged = False

    def change_speed(self, steps: int) -> None:
        self.speed = min(FASTEST, max(SLOWEST, self.speed * SPEED_STEP**steps))

    def label(self, verdict: int, episode: int) -> None:
        """Judges the running episode, which ends it."""
        self._label, self._label_left, self._episode = verdict, LABEL_MESSAGES, episode

    def begin_episode(self, episode: int, phase: int) -> None:
        """The next episode belongs to the policy, unless it is a demonstration; an old verdict is not for it."""
        if phase != world_state_t.DEMONSTRATION:
            self.release()
        if episode != self._episode:
            self._label_left = 0

    def command(self, twist: Sequence[float]) -> teleop_command_t:
        """The message of now. `twist` [-1, 1]: what the device asks for at full speed."""
        message = teleop_command_t()
        message.utime = utime()
        message.tick_answered = -1
        message.episode_answered = -1
        message.operator_id = self.operator_id
        message.engaged = int(self.engaged)
        message.device_gripper = self.gripper
        message.device_twist = [self.speed * value if self.engaged else 0.0 for value in twist]
        if self._label_left > 0:
            self._label_left -= 1
            message.label, message.episode_answered = self._label, self._episode
        return message
