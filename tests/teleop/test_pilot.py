"""What goes out: within range, hands off by default, labels that can be lost once and never hit another episode."""

from tandem_lcm.tandem.teleop_command_t import teleop_command_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.teleop.pilot import LABEL_MESSAGES, Pilot

STILL = [0.0] * 6


def test_hands_off_asks_for_nothing() -> None:
    command = Pilot("keyboard").command([1.0] * 6)
    assert command.engaged == 0 and list(command.device_twist) == STILL
    assert command.label == teleop_command_t.LABEL_NONE
    assert (command.episode_answered, command.tick_answered) == (-1, -1)
    assert teleop_command_t.decode(command.encode()).operator_id == "keyboard"


def test_speed_scales_the_twist_within_its_bounds() -> None:
    pilot = Pilot("keyboard")
    pilot.engage(0.02)
    for steps, bound in ((40, 1.0), (-80, 0.05)):
        pilot.change_speed(steps)
        assert pilot.speed == bound
        assert max(pilot.command([1.0, -1.0, 0, 0, 0, 0]).device_twist) == bound


def test_a_label_goes_out_several_times_for_its_episode_only() -> None:
    pilot = Pilot("keyboard")
    pilot.label(teleop_command_t.LABEL_SUCCESS, 7)
    sent = [pilot.command(STILL) for _ in range(LABEL_MESSAGES + 5)]
    assert [c.label for c in sent].count(teleop_command_t.LABEL_SUCCESS) == LABEL_MESSAGES
    assert {c.episode_answered for c in sent if c.label} == {7}
    pilot.label(teleop_command_t.LABEL_FAIL, 7)
    assert pilot.command(STILL).label == teleop_command_t.LABEL_FAIL
    pilot.begin_episode(8, world_state_t.TRAINING)
    assert pilot.command(STILL).label == teleop_command_t.LABEL_NONE


def test_a_training_episode_begins_in_the_policys_hands_and_a_demonstration_goes_on() -> None:
    pilot = Pilot("keyboard")
    pilot.engage(0.02)
    pilot.begin_episode(1, world_state_t.DEMONSTRATION)
    assert pilot.engaged
    pilot.begin_episode(2, world_state_t.TRAINING)
    assert not pilot.engaged


def test_taking_the_arm_leaves_the_gripper_as_it_is() -> None:
    for width, gripper in ((0.0, 1.0), (0.02, 1.0), (0.08, -1.0)):
        pilot = Pilot("keyboard")
        pilot.engage(width)
        assert pilot.command(STILL).device_gripper == gripper
    pilot.gripper = 1.0
    pilot.engage(0.08)  # he has it already
    assert pilot.gripper == 1.0
