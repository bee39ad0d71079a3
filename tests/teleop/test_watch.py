"""The screen's figures: the object's pose from the goal, forces against their bound, faults in words."""

import math
import re
from pathlib import Path

import pytest
from tandem_lcm.tandem.controller_fault_t import controller_fault_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.robot_state_t import robot_state_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem import faults
from tandem.processes import free_lcm_url
from tandem.teleop import screen
from tandem.teleop.watch import Watch, object_in_goal
from tandem.wire import Wire

HEADER = Path(__file__).parents[2] / "src" / "controller" / "robot" / "fault.h"


def turned_down(yaw: float) -> list[float]:
    """An object whose z points down, turned by yaw about the base's z."""
    return [0.0, math.cos(yaw / 2), math.sin(yaw / 2), 0.0]


@pytest.mark.parametrize("goal_yaw", [0.0, 0.4, -3.0])
@pytest.mark.parametrize("yaw", [0.0, 0.1, -0.7])
def test_object_is_seen_from_the_goal(goal_yaw: float, yaw: float) -> None:
    world = world_state_t()
    world.p_WG = [0.5, 0.1, 0.04]
    world.q_WG = [math.cos(goal_yaw / 2), 0.0, 0.0, math.sin(goal_yaw / 2)]
    along = [0.003, -0.002, 0.02]  # in the goal's axes
    c, s = math.cos(goal_yaw), math.sin(goal_yaw)
    world.p_WO = [0.5 + c * along[0] - s * along[1], 0.1 + s * along[0] + c * along[1], 0.04 + along[2]]
    world.q_WO = turned_down(goal_yaw + yaw)
    position, turn, tilt = object_in_goal(world)
    assert position == pytest.approx(along)
    assert turn == pytest.approx(yaw)
    assert tilt == pytest.approx(0.0, abs=1e-9)


def test_every_fault_of_the_controller_has_words() -> None:
    codes = [int(code) for code in re.findall(r"^\s+\w+ = (\d+),", HEADER.read_text(), re.MULTILINE)]
    assert len(codes) > 10
    assert [code for code in codes if faults.fault_text(code).startswith("fault ")] == []
    assert faults.fault_text(99) == "fault 99"


def test_the_screen_shows_mode_fault_forces_and_pose() -> None:
    wire = Wire(free_lcm_url())
    watch = Watch(wire, lambda status: None)
    view = screen.View(title="teleop", engaged=True, speed=0.5, held="+x", help=[("x", "E-STOP")])
    assert "not heard yet" in screen.line(view, watch)
    status = controller_status_t()
    status.state, status.fault, status.episode = status.HALTED, 6, 12
    status.source_grade = [0, 2, 0]
    fault = controller_fault_t()
    fault.fault, fault.sentence = 6, "the force was 120 N, above 100 N"
    watch.robot = robot_state_t()
    watch.robot.F_ext_W = [10.0, 0, -30.0, 0, 0, 0]
    watch.robot.force_bound_W = [20.0] * 6
    watch.robot.alpha = 0.75
    watch._hear_status(status, b"")
    watch._fault = fault
    text = screen.line(view, watch)
    for part in (
        "halted",
        "episode 12",
        "operator damp",
        "120 N, above",
        "ENGAGED",
        "0.75",
        "+10.0/20",
    ):
        assert part in text, part
    assert screen.bar(0.5).count("█") == screen.BAR / 2
    assert screen.bar(9.0, "ascii") == "#" * screen.BAR and screen.bar(math.nan).count("█") == 0
