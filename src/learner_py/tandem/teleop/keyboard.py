"""The keyboard as a device: keys of a terminal, diagonals included."""

from typing import ClassVar

from tandem.teleop.device import Action
from tandem.teleop.held_keys import Direction, ExactKeys, HeldKeys, RepeatedKeys
from tandem.teleop.keys import Key, Kind
from tandem.teleop.motion import Ramp, wanted

RISE_S, FALL_S = 0.5, 0.1

# Base axes: x away from the robot's base, y to its left, z up.
MOTIONS = {
    "w": Direction(0, 1),
    "s": Direction(0, -1),
    "a": Direction(1, 1),
    "d": Direction(1, -1),
    "r": Direction(2, 1),
    "f": Direction(2, -1),
    "l": Direction(3, 1),
    "j": Direction(3, -1),
    "i": Direction(4, 1),
    "k": Direction(4, -1),
    "q": Direction(5, 1),
    "e": Direction(5, -1),
    "up": Direction(0, 1),
    "down": Direction(0, -1),
    "left": Direction(1, 1),
    "right": Direction(1, -1),
    "pageup": Direction(2, 1),
    "pagedown": Direction(2, -1),
}
ACTIONS = {
    "enter": Action.engage,
    "backspace": Action.release,
    "1": Action.success,
    "2": Action.failure,
    "3": Action.discard,
    "c": Action.close,
    "v": Action.open,
    "+": Action.faster,
    "=": Action.faster,
    "-": Action.slower,
    "_": Action.slower,
    "x": Action.estop,
    "p": Action.recover,
    "ctrl+c": Action.leave,
}
ACTION_HELP = [
    ("1 2 3", "success fail discard"),
    ("c v", "close, open hand"),
    ("+ -", "faster, slower"),
    ("x", "E-STOP"),
    ("p", "recover"),
    ("Ctrl-C", "leave"),
]
_NAMES = ("x", "y", "z", "rx", "ry", "rz")


def action_of(key: Key) -> Action | None:
    """Actions come once a press. A plain terminal repeats them; none of them minds."""
    return ACTIONS.get(key.name) if key.kind is Kind.press else None


class Keyboard:
    """Directions from held keys, smoothed. Space, and losing the keyboard's focus, let go of all of them."""

    operator_id = "keyboard"
    help: ClassVar = [
        ("Enter", "take the arm"),
        ("Backspace", "let go"),
        ("w s", "x away, back"),
        ("a d", "y left, right"),
        ("r f", "z up, down"),
        ("q e", "turn (rz)"),
        ("i k", "tilt (ry)"),
        ("j l", "tilt (rx)"),
        ("Space", "stand still"),
        *ACTION_HELP,
    ]

    def __init__(self) -> None:
        self._keys: HeldKeys = RepeatedKeys()
        self._ramp = Ramp(RISE_S, FALL_S)

    def key(self, key: Key, now: float) -> Action | None:
        if key.name == "kitty":
            self._keys = ExactKeys()
        elif key.name in ("space", "blur"):
            self._keys.clear()
            self._ramp.stop()
        elif direction := MOTIONS.get(key.name):
            if key.kind is Kind.release:
                self._keys.release(direction)
            else:
                self._keys.press(direction, now)
        return action_of(key)

    def poll(self, now: float) -> list[Action]:
        return []

    def twist(self, now: float, dt: float) -> list[float]:
        return self._ramp.step(wanted(self._keys.held(now)), dt)

    def lost(self) -> str:
        return ""

    def describe(self, now: float) -> str:
        exact = "" if isinstance(self._keys, ExactKeys) else " (held keys guessed)"
        held = sorted(self._keys.held(now))
        return " ".join(f"{'+' if sign > 0 else '-'}{_NAMES[axis]}" for axis, sign in held) + exact
