"""A pad, by SDL's virtual joystick: axes, dead man's switch, buttons, unplugging."""

from collections.abc import Iterator
from typing import Any

import pytest

from tandem.teleop.device import Action
from tandem.teleop.gamepad import DEAD_ZONE, Gamepad, sdl2
from tandem.teleop.keys import Key

DT = 0.02


class VirtualPad:
    """A pad that is plugged in at once; buttons and axes are numbered as in SDL's game controllers."""

    def __init__(self) -> None:
        self.index = sdl2.SDL_JoystickAttachVirtual(sdl2.SDL_JOYSTICK_TYPE_GAMECONTROLLER, 6, 15, 0)
        self.joystick: Any = sdl2.SDL_JoystickOpen(self.index)
        for trigger in (4, 5):
            self.axis(trigger, -1.0)

    def axis(self, axis: int, value: float) -> None:
        sdl2.SDL_JoystickSetVirtualAxis(self.joystick, axis, round(32767 * value))

    def button(self, button: int, down: bool) -> None:
        sdl2.SDL_JoystickSetVirtualButton(self.joystick, button, int(down))

    def unplug(self) -> None:
        sdl2.SDL_JoystickClose(self.joystick)
        sdl2.SDL_JoystickDetachVirtual(self.index)


@pytest.fixture
def gamepad() -> Iterator[Gamepad]:
    device = Gamepad()
    yield device
    device.close()


@pytest.fixture
def pad(gamepad: Gamepad) -> VirtualPad:
    return VirtualPad()


def settle(gamepad: Gamepad) -> list[float]:
    for _ in range(50):
        gamepad.poll(0.0)
        twist = gamepad.twist(0.0, DT)
    return twist


def test_no_pad_says_so_and_asks_for_nothing(gamepad: Gamepad) -> None:
    assert gamepad.poll(0.0) == []
    assert gamepad.lost().startswith("no pad is there")
    assert gamepad.twist(0.0, DT) == [0.0] * 6


@pytest.mark.parametrize(
    ("axis", "value", "direction", "sign"),
    [(1, -1.0, 0, 1), (0, -1.0, 1, 1), (3, -1.0, 2, 1), (2, -1.0, 5, 1), (1, 1.0, 0, -1), (2, 1.0, 5, -1)],
)
def test_sticks_move_the_right_axis_the_right_way_to_the_full(
    gamepad: Gamepad, pad: VirtualPad, axis: int, value: float, direction: int, sign: int
) -> None:
    pad.axis(axis, value)
    twist = settle(gamepad)
    assert twist[direction] == pytest.approx(sign, abs=1e-3)
    assert sum(abs(v) for v in twist) == pytest.approx(1.0, abs=1e-3)


def test_a_resting_stick_and_its_drift_move_nothing_and_motion_is_smooth(
    gamepad: Gamepad, pad: VirtualPad
) -> None:
    pad.axis(0, 0.9 * DEAD_ZONE)
    assert settle(gamepad) == [0.0] * 6
    pad.axis(0, 1.0)
    gamepad.poll(0.0)
    assert abs(gamepad.twist(0.0, DT)[1]) <= 0.1 + 1e-9


def test_the_shoulder_button_is_a_dead_mans_switch(gamepad: Gamepad, pad: VirtualPad) -> None:
    gamepad.poll(0.0)
    pad.button(sdl2.SDL_CONTROLLER_BUTTON_RIGHTSHOULDER, True)
    assert gamepad.poll(0.0) == [Action.engage]
    assert gamepad.poll(0.0) == []
    pad.button(sdl2.SDL_CONTROLLER_BUTTON_RIGHTSHOULDER, False)
    assert gamepad.poll(0.0) == [Action.release]
    assert gamepad.key(Key("enter"), 0.0) is None  # the keyboard can't hold it down
    assert gamepad.key(Key("x"), 0.0) is Action.estop


@pytest.mark.parametrize(
    ("button", "action"),
    [(0, Action.success), (1, Action.failure), (2, Action.discard), (4, Action.estop), (6, Action.recover)],
)
def test_buttons_act_once_a_press(gamepad: Gamepad, pad: VirtualPad, button: int, action: Action) -> None:
    gamepad.poll(0.0)
    pad.button(button, True)
    assert gamepad.poll(0.0) == [action]
    assert gamepad.poll(0.0) == []


def test_triggers_work_the_gripper(gamepad: Gamepad, pad: VirtualPad) -> None:
    gamepad.poll(0.0)
    pad.axis(5, 1.0)
    assert gamepad.poll(0.0) == [Action.close]
    pad.axis(5, -1.0)
    gamepad.poll(0.0)
    pad.axis(4, 1.0)
    assert gamepad.poll(0.0) == [Action.open]


def test_an_unplugged_pad_stops_at_once_and_a_new_one_starts_from_rest(
    gamepad: Gamepad, pad: VirtualPad
) -> None:
    pad.axis(0, -1.0)
    pad.button(sdl2.SDL_CONTROLLER_BUTTON_RIGHTSHOULDER, True)
    assert settle(gamepad)[1] == pytest.approx(1.0, abs=1e-3)
    pad.unplug()
    assert gamepad.poll(0.0) == []
    assert gamepad.twist(0.0, DT) == [0.0] * 6
    assert gamepad.lost().startswith("the pad is gone")
    again = VirtualPad()
    again.button(sdl2.SDL_CONTROLLER_BUTTON_RIGHTSHOULDER, True)
    gamepad.poll(0.0)
    assert gamepad.lost() == ""
    again.unplug()
