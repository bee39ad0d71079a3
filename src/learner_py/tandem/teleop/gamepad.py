"""A gamepad as a device, through SDL's game controller interface: any pad that it knows has the same layout.

The right shoulder button is a dead man's switch: hold it to have the arm, let it go and the policy has it. The keys of
the terminal label, recover and stop as with the keyboard. Pads come and go while we run.
"""

import ctypes
import warnings
from collections.abc import Iterable
from typing import ClassVar

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it tells which library it found
    import sdl2

from tandem.teleop.device import Action
from tandem.teleop.held_keys import Direction
from tandem.teleop.keyboard import action_of
from tandem.teleop.keys import Key
from tandem.teleop.motion import AXES, Ramp, deflection, wanted

DEAD_ZONE = 0.12
RISE_S, FALL_S = 0.2, 0.08
PULLED = 0.5  # of a trigger

_STICKS = {  # SDL's axis (right and down positive) -> axis of the twist, sign
    sdl2.SDL_CONTROLLER_AXIS_LEFTY: Direction(0, -1),
    sdl2.SDL_CONTROLLER_AXIS_LEFTX: Direction(1, -1),
    sdl2.SDL_CONTROLLER_AXIS_RIGHTY: Direction(2, -1),
    sdl2.SDL_CONTROLLER_AXIS_RIGHTX: Direction(5, -1),
}
_CROSS = {
    sdl2.SDL_CONTROLLER_BUTTON_DPAD_UP: Direction(4, 1),
    sdl2.SDL_CONTROLLER_BUTTON_DPAD_DOWN: Direction(4, -1),
    sdl2.SDL_CONTROLLER_BUTTON_DPAD_RIGHT: Direction(3, 1),
    sdl2.SDL_CONTROLLER_BUTTON_DPAD_LEFT: Direction(3, -1),
}
_DEAD_MAN = sdl2.SDL_CONTROLLER_BUTTON_RIGHTSHOULDER
_BUTTONS = {
    sdl2.SDL_CONTROLLER_BUTTON_A: Action.success,
    sdl2.SDL_CONTROLLER_BUTTON_B: Action.failure,
    sdl2.SDL_CONTROLLER_BUTTON_X: Action.discard,
    sdl2.SDL_CONTROLLER_BUTTON_BACK: Action.estop,
    sdl2.SDL_CONTROLLER_BUTTON_START: Action.recover,
    sdl2.SDL_CONTROLLER_BUTTON_LEFTSTICK: Action.slower,
    sdl2.SDL_CONTROLLER_BUTTON_RIGHTSTICK: Action.faster,
}
_TRIGGERS = {
    sdl2.SDL_CONTROLLER_AXIS_TRIGGERRIGHT: Action.close,
    sdl2.SDL_CONTROLLER_AXIS_TRIGGERLEFT: Action.open,
}


class Gamepad:
    """The first pad that is there."""

    operator_id = "gamepad"
    help: ClassVar = [
        ("right shoulder", "hold: take the arm"),
        ("left stick", "x, y"),
        ("right stick", "z, turn (rz)"),
        ("cross", "tilt (ry, rx)"),
        ("triggers", "open, close hand"),
        ("A B X", "success fail discard"),
        ("stick clicks", "slower, faster"),
        ("Back", "E-STOP"),
        ("Start", "recover"),
        ("keys 1 2 3", "success fail discard"),
        ("x p", "E-STOP, recover"),
        ("Ctrl-C", "leave"),
    ]

    def __init__(self) -> None:
        """@raises RuntimeError with a sentence when SDL does not start."""
        sdl2.SDL_SetHint(sdl2.SDL_HINT_NO_SIGNAL_HANDLERS, b"1")
        sdl2.SDL_SetHint(sdl2.SDL_HINT_JOYSTICK_ALLOW_BACKGROUND_EVENTS, b"1")  # we have no window
        if sdl2.SDL_Init(sdl2.SDL_INIT_GAMECONTROLLER) != 0:
            reason = sdl2.SDL_GetError().decode("utf-8", "replace")
            raise RuntimeError(f"SDL does not start its game controllers ({reason}).")
        self._pad: ctypes.c_void_p | None = None
        self._name = ""
        self._was_there = False
        self._pressed: set[object] = set()
        self._ramp = Ramp(RISE_S, FALL_S)

    def close(self) -> None:
        self._let_go_of_pad()
        sdl2.SDL_QuitSubSystem(sdl2.SDL_INIT_GAMECONTROLLER)

    def key(self, key: Key, now: float) -> Action | None:
        action = action_of(key)
        return action if action is not Action.engage else None  # without the switch he could not let go again

    def poll(self, now: float) -> list[Action]:
        sdl2.SDL_GameControllerUpdate()
        event = sdl2.SDL_Event()
        while sdl2.SDL_PollEvent(ctypes.byref(event)):
            pass  # we read positions; an unread queue would fill
        if self._pad and not sdl2.SDL_GameControllerGetAttached(self._pad):
            self._let_go_of_pad()
        if not self._pad:
            self._find_pad()
        if not self._pad:
            return []
        pressed: set[object] = {b for b in (*_BUTTONS, _DEAD_MAN) if self._button(b)}
        pressed |= {("trigger", axis) for axis in _TRIGGERS if self._axis(axis) > PULLED}
        new, gone, self._pressed = pressed - self._pressed, self._pressed - pressed, pressed
        actions = [_BUTTONS[b] for b in _BUTTONS if b in new]
        actions += [_TRIGGERS[axis] for axis in _TRIGGERS if ("trigger", axis) in new]
        if _DEAD_MAN in new:
            actions.append(Action.engage)
        if _DEAD_MAN in gone:
            actions.append(Action.release)
        return actions

    def twist(self, now: float, dt: float) -> list[float]:
        if not self._pad:
            self._ramp.stop()
            return self._ramp.value
        asked = wanted(self._crossed())
        for axis, (direction, sign) in _STICKS.items():
            asked[direction] = sign * deflection(self._axis(axis), DEAD_ZONE)
        return self._ramp.step(asked, dt)

    def lost(self) -> str:
        if self._pad:
            return ""
        what = "the pad is gone" if self._was_there else "no pad is there"
        return f"{what}; connect one (it needs read access to /dev/input/event*)"

    def describe(self, now: float) -> str:
        moving = " ".join(f"{value:+.2f}" for value in self._ramp.value[:AXES])
        return f"{self._name}  {moving}" if self._pad else ""

    def _crossed(self) -> Iterable[Direction]:
        return [direction for button, direction in _CROSS.items() if self._button(button)]

    def _button(self, button: int) -> bool:
        return bool(sdl2.SDL_GameControllerGetButton(self._pad, button))

    def _axis(self, axis: int) -> float:
        """[-1, 1]."""
        return max(-1.0, float(sdl2.SDL_GameControllerGetAxis(self._pad, axis)) / 32767.0)

    def _find_pad(self) -> None:
        for index in range(sdl2.SDL_NumJoysticks()):
            if sdl2.SDL_IsGameController(index) and (pad := sdl2.SDL_GameControllerOpen(index)):
                name = sdl2.SDL_GameControllerName(pad)
                self._pad, self._name = pad, name.decode("utf-8", "replace") if name else "pad"
                self._was_there = True
                # A switch that is held already has not been pressed for us.
                self._pressed = {_DEAD_MAN} if self._button(_DEAD_MAN) else set()
                return

    def _let_go_of_pad(self) -> None:
        if self._pad:
            sdl2.SDL_GameControllerClose(self._pad)
        self._pad = None
        self._pressed = set()
        self._ramp.stop()
