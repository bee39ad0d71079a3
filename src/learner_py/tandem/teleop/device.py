"""What the session expects of a device, and what a person can ask for beside motion."""

from enum import StrEnum
from typing import Protocol

from tandem.teleop.keys import Key


class Action(StrEnum):
    engage = "take the arm"
    release = "let go"
    success = "label success"
    failure = "label failure"
    discard = "label discard"
    close = "close the gripper"
    open = "open the gripper"
    faster = "faster"
    slower = "slower"
    estop = "E-STOP"
    recover = "recover"
    leave = "leave"


class Device(Protocol):
    """Times are seconds on the monotonic clock."""

    operator_id: str
    help: list[tuple[str, str]]  # key, what it does

    def key(self, key: Key, now: float) -> Action | None:
        """A key event of the terminal."""

    def poll(self, now: float) -> list[Action]:
        """What the device itself asks for since the last call."""

    def twist(self, now: float, dt: float) -> list[float]:
        """Device twist for the next `dt` s at full speed, [-1, 1]."""

    def lost(self) -> str:
        """A clause when the device is gone, empty while it is there."""

    def describe(self, now: float) -> str:
        """What is held now, for the screen."""
