"""`tandem teleop` as a program in a pseudo-terminal, with a controller that only listens."""

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest
from fake_controller import FakeController
from person import Person, wait_for
from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.teleop_command_t import teleop_command_t

from tandem.processes import free_lcm_url

ENVIRONMENT = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


@pytest.fixture
def controller() -> Iterator[FakeController]:
    with FakeController(free_lcm_url()) as fake:
        yield fake


@pytest.fixture
def person(controller: FakeController) -> Iterator[Person]:
    command = [sys.executable, "-m", "tandem", "teleop", "keyboard", "--lcm-url", controller.url]
    with Person(command, ENVIRONMENT) as at_the_keys:
        at_the_keys.see("running")
        yield at_the_keys


def latest(controller: FakeController) -> Any:
    return controller.teleop[-1][1]


def engage(person: Person, controller: FakeController) -> None:
    person.type("\r")
    wait_for(lambda: latest(controller).engaged)


def test_commands_come_fifty_times_a_second_with_hands_off(
    person: Person, controller: FakeController
) -> None:
    start = len(controller.teleop)
    time.sleep(1.0)
    assert 30 <= len(controller.teleop) - start <= 55  # fewer on a busy machine
    assert not any(command.engaged for _, command in controller.teleop)
    person.type("wad")
    time.sleep(0.2)
    assert list(latest(controller).device_twist) == [0.0] * 6
    assert latest(controller).operator_id == "keyboard"


def test_a_held_key_moves_smoothly_to_full_speed_and_stops(
    person: Person, controller: FakeController
) -> None:
    engage(person, controller)
    start = len(controller.teleop)
    person.hold("w", 1.0)
    wait_for(lambda: latest(controller).device_twist[0] == 0.0)
    speeds = [command.device_twist[0] for _, command in controller.teleop[start:]]
    assert max(speeds) == pytest.approx(0.5)
    assert all(abs(b - a) <= 0.5 * 0.4 + 1e-9 for a, b in itertools.pairwise(speeds))
    person.type("+")
    wait_for(lambda: (person.hold("w", 0.1), latest(controller).device_twist[0] > 0.6)[1])


def test_diagonals_space_and_letting_go(person: Person, controller: FakeController) -> None:
    engage(person, controller)
    person.type("w")
    wait_for(lambda: (person.hold("a", 0.05), min(latest(controller).device_twist[:2]) > 0.3)[1])
    person.type(" ")
    wait_for(lambda: list(latest(controller).device_twist) == [0.0] * 6)
    person.type(b"\x7f")
    wait_for(lambda: not latest(controller).engaged)


def test_a_terminal_with_the_kitty_protocol_tells_of_releases(
    person: Person, controller: FakeController
) -> None:
    engage(person, controller)
    person.see("\x1b[?u")  # it asks
    person.type(b"\x1b[?0u")
    person.see("\x1b[>11u")  # it switches on
    person.type(b"\x1b[119;1:1u\x1b[97;1:1u")
    time.sleep(1.0)  # no repeats needed
    assert list(latest(controller).device_twist[:2]) == pytest.approx([0.5, 0.5])
    person.type(b"\x1b[119;1:3u")
    wait_for(lambda: latest(controller).device_twist[0] == 0.0)
    assert latest(controller).device_twist[1] == pytest.approx(0.5)
    person.type(b"\x1b[O")  # another window has the keyboard now: we shall not hear of the release
    wait_for(lambda: latest(controller).device_twist[1] == 0.0)
    person.type(b"\x1b[99;5u")
    assert person.wait() == 0
    assert "\x1b[<u" in person.seen and person.restored


@pytest.mark.parametrize(
    ("key", "label"),
    [
        ("1", teleop_command_t.LABEL_SUCCESS),
        ("2", teleop_command_t.LABEL_FAIL),
        ("3", teleop_command_t.LABEL_DISCARD),
    ],
)
def test_labels_name_their_episode_and_a_held_key_does_not_label_the_next(
    person: Person, controller: FakeController, key: str, label: int
) -> None:
    person.hold(key, 1.3)
    assert controller.status.episode == 6
    labels = [(c.label, c.episode_answered) for _, c in controller.teleop if c.label]
    assert set(labels) == {(label, 5)}


def test_estop_and_recover_are_confirmed_and_hands_come_off(
    person: Person, controller: FakeController
) -> None:
    engage(person, controller)
    person.type("x")
    wait_for(lambda: controller_command_t.ESTOP in controller.orders)
    wait_for(lambda: not latest(controller).engaged)
    person.see("halted")
    person.see("an e-stop command")
    person.type("\r")  # nothing to take now
    time.sleep(0.2)
    assert not latest(controller).engaged
    person.type("p")
    wait_for(lambda: controller.status.episode == 6)
    time.sleep(1.0)
    assert controller.orders.count(controller_command_t.RECOVER) == 1
    assert not latest(controller).engaged


def test_the_screen_shows_forces_pose_and_keys(person: Person, controller: FakeController) -> None:
    for text in ("force", "/20", "z  +12.3 mm", "E-STOP", "demonstrations", "episode 5"):
        person.see(text)


def test_ctrl_c_says_hands_off_and_gives_the_terminal_back(
    person: Person, controller: FakeController
) -> None:
    engage(person, controller)
    person.type(b"\x03")
    assert person.wait() == 0
    wait_for(lambda: not latest(controller).engaged)
    assert person.restored
    assert "\x1b[?1049l" in person.seen


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_give_the_terminal_back(person: Person, controller: FakeController, number: int) -> None:
    os.kill(person.pid, number)
    assert person.wait() == 0
    assert person.restored


def test_a_lost_terminal_ends_in_silence_so_that_the_controller_holds(
    person: Person, controller: FakeController
) -> None:
    engage(person, controller)
    person.hang_up()
    assert person.wait() == 0
    time.sleep(0.1)
    assert latest(controller).engaged  # it did not hand the arm back itself


def test_a_killed_program_falls_silent(person: Person, controller: FakeController) -> None:
    engage(person, controller)
    os.kill(person.pid, signal.SIGKILL)
    person.wait()
    time.sleep(0.1)
    count = len(controller.teleop)
    time.sleep(0.3)
    assert len(controller.teleop) == count


def test_the_keyboard_needs_a_terminal() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tandem", "teleop", "keyboard", "--lcm-url", free_lcm_url()],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env={**os.environ, **ENVIRONMENT},
    )
    assert done.returncode == 2
    assert "needs a terminal" in done.stderr


def test_a_controller_that_is_not_there_is_named(controller: FakeController) -> None:
    url = free_lcm_url()
    with Person(
        [sys.executable, "-m", "tandem", "teleop", "keyboard", "--lcm-url", url], ENVIRONMENT
    ) as alone:
        alone.see("not heard yet")
        alone.type("\r")
        alone.see("nothing to take")


def test_the_gamepad_without_a_pad_says_so_and_needs_no_terminal(controller: FakeController) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "tandem", "teleop", "gamepad", "--lcm-url", controller.url],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **ENVIRONMENT},
    )
    wait_for(lambda: len(controller.teleop) > 20)
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=10)
    assert process.returncode == 0
    assert not any(command.engaged for _, command in controller.teleop)
    assert "no pad is there" in out
