"""The soak's questions, asked of logs made by hand: each can be answered with no."""

from pathlib import Path
from typing import Any

import lcm
import pytest
from tandem_lcm.tandem.control_tick_t import control_tick_t
from tandem_lcm.tandem.controller_fault_t import controller_fault_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.soak.checks import (
    delivered_once,
    faults_declared,
    garbage_refused,
    is_declared,
    is_learnable,
    torques_within_limits,
)
from tandem.wire import CHANNEL_OF

COLLISION, ESTOP = 6, 23


def tick(commanded: list[float], received: list[float], number: int = 0) -> control_tick_t:
    message = control_tick_t()
    message.tick, message.tau_commanded, message.tau_received = number, commanded, received
    return message


def write_log(path: Path, *events: Any) -> Path:
    log = lcm.EventLog(str(path), "w", overwrite=True)
    for time, message in enumerate(events):
        log.write_event(time, CHANNEL_OF[type(message)], message.encode())
    log.close()
    return path


def end(number: int, outcome: int = episode_end_t.SUCCESS, **facts: int) -> episode_end_t:
    message = episode_end_t()
    message.episode, message.outcome, message.phase = number, outcome, world_state_t.TRAINING
    message.n_steps = 10
    for name, value in facts.items():
        setattr(message, name, value)
    return message


def fault(number: int, code: int) -> controller_fault_t:
    message = controller_fault_t()
    message.episode, message.fault = number, code
    return message


# ---- torques


def test_torques_at_the_limits_pass_and_are_all_counted(tmp_path: Path) -> None:
    most = [87.0, -87.0, 87.0, 0.0, 12.0, -12.0, 0.0]
    before = [86.0, -86.0, 87.0, 1.0, 11.0, -11.0, -1.0]
    log = write_log(tmp_path / "log.lcm", *(tick(most, before, n) for n in range(50)))
    check = torques_within_limits(log)
    assert check.passed, check.sentence
    assert check.figures["ticks"] == 50
    assert check.figures["largest_share_of_limit"] == 1.0
    assert check.figures["largest_step_Nm"] == 1.0


@pytest.mark.parametrize(
    ("commanded", "received", "figure"),
    [
        ([0.0] * 6 + [12.001], [0.0] * 6 + [11.5], "beyond_limit"),
        ([-87.001] + [0.0] * 6, [-86.5] + [0.0] * 6, "beyond_limit"),
        ([0.0, 1.001] + [0.0] * 5, [0.0] * 7, "beyond_step"),
        ([float("nan")] + [0.0] * 6, [0.0] * 7, "not_finite"),
        ([0.0] * 7, [float("inf")] + [0.0] * 6, "not_finite"),
    ],
)
def test_one_tick_beyond_a_limit_is_found_and_named(
    tmp_path: Path, commanded: list[float], received: list[float], figure: str
) -> None:
    zero = [0.0] * 7
    ticks = [tick(zero, zero, 0), tick(commanded, received, 1), tick(zero, zero, 2)]
    check = torques_within_limits(write_log(tmp_path / "log.lcm", *ticks))
    assert not check.passed
    assert check.figures[figure] == 1
    assert "tick 1" in check.sentence


def test_log_without_ticks_proves_nothing(tmp_path: Path) -> None:
    assert not torques_within_limits(write_log(tmp_path / "log.lcm", end(0))).passed


# ---- faults


def test_declared_faults_with_their_episodes_pass() -> None:
    ends = [end(0), end(1, episode_end_t.FAULT, fault=COLLISION), end(2, episode_end_t.FAULT, fault=ESTOP)]
    told = [fault(1, COLLISION), fault(2, ESTOP), fault(-1, ESTOP)]  # the last while nothing ran
    check = faults_declared(told, ends, {0, 1, 2, 3}, {COLLISION: 1, ESTOP: 2}, ended_well=False)
    assert check.passed, check.sentence
    assert sum(check.figures["faults"].values()) == 3


@pytest.mark.parametrize(
    ("told", "ends", "halted", "what"),
    [
        ([fault(0, 77)], [end(0, episode_end_t.FAULT, fault=77)], {}, "undeclared"),
        ([fault(0, COLLISION)], [end(0, episode_end_t.FAULT, fault=ESTOP)], {}, "but ended with"),
        ([fault(0, COLLISION)], [end(0)], {}, "but ended with"),
        ([fault(0, COLLISION)], [], {}, "no end"),
        ([], [end(0, episode_end_t.FAULT, fault=COLLISION)], {}, "told 0 times"),
        ([fault(0, COLLISION)] * 2, [end(0, episode_end_t.FAULT, fault=COLLISION)], {}, "told 2 times"),
        ([], [end(0)], {0: 1}, "halted by the undeclared"),
    ],
)
def test_fault_that_is_not_what_its_episode_says_fails(
    told: list[controller_fault_t], ends: list[episode_end_t], halted: dict[int, int], what: str
) -> None:
    check = faults_declared(told, ends, {0, 1}, halted, ended_well=True)
    assert not check.passed
    assert what in check.sentence


def test_fault_after_which_nothing_came_fails_unless_the_run_ended_well() -> None:
    told, ends = [fault(4, COLLISION)], [end(4, episode_end_t.FAULT, fault=COLLISION)]
    assert not faults_declared(told, ends, {4}, {}, ended_well=False).passed
    assert faults_declared(told, ends, {4}, {}, ended_well=True).passed


def test_declared_faults_are_those_of_the_controllers_header() -> None:
    header = (Path(__file__).parents[2] / "src/controller/robot/fault.h").read_text()
    codes = {int(line.split("=")[1].split(",")[0]) for line in header.splitlines() if " = " in line}
    assert {code for code in range(-5, 100) if is_declared(code)} == codes - {0}


# ---- delivery


ENDS = [
    end(0, phase=world_state_t.DEMONSTRATION, n_steps=30),
    end(1, episode_end_t.DISCARD, phase=world_state_t.DEMONSTRATION),
    end(2, episode_end_t.TIMEOUT, n_steps=120),
    end(3, episode_end_t.FAULT, fault=COLLISION),
    end(4, episode_end_t.FAILURE, n_steps=7),
]
HEARD = dict.fromkeys(range(5), 1)


def test_learner_that_holds_each_learnable_episode_once_passes() -> None:
    check = delivered_once(ENDS, HEARD, set(), buffer_steps=157, trained_through=4)
    assert check.passed, check.sentence
    assert check.figures["learnable"] == 3


@pytest.mark.parametrize(
    ("facts", "what"),
    [
        ({"buffer_steps": 150}, "holds 150 steps"),  # one is missing
        ({"buffer_steps": 164}, "holds 164 steps"),  # one came twice
        ({"buffer_steps": None}, "holds None steps"),
        ({"trained_through": 3}, "trained through episode 3"),
        ({"acknowledged": {0: 1, 1: 1, 3: 1, 4: 1}}, "episode 2 was never acknowledged"),
        ({"ends": [*ENDS, ENDS[-1]]}, "place 5"),
        ({"ends": [ENDS[0], *ENDS[2:]]}, "place 1"),
        ({"ends": []}, "holds 157"),
    ],
)
def test_episode_that_is_lost_or_comes_twice_fails(facts: dict[str, Any], what: str) -> None:
    given: dict[str, Any] = {
        "ends": ENDS,
        "acknowledged": HEARD,
        "forged": set(),
        "buffer_steps": 157,
        "trained_through": 4,
    }
    check = delivered_once(**{**given, **facts})
    assert not check.passed
    assert what in check.sentence


def test_forged_acknowledgement_is_no_proof_and_no_demand() -> None:
    heard = {0: 1, 1: 1, 2: 1, 3: 1}
    assert delivered_once(ENDS, heard, {4}, 157, 4).passed
    assert not delivered_once(ENDS, heard, {4}, 150, 4).passed


def test_only_good_demonstrations_are_for_learning() -> None:
    for outcome in range(5):
        demonstration = end(0, outcome, phase=world_state_t.DEMONSTRATION)
        assert is_learnable(demonstration) == (outcome == episode_end_t.SUCCESS)
    assert not is_learnable(end(0, phase=world_state_t.EVALUATION))
    assert not is_learnable(end(0, n_steps=0))


# ---- garbage


def test_garbage_that_was_taken_fails() -> None:
    status = controller_status_t()
    status.gains_accepted = 3
    assert garbage_refused(status, 3, 3, 100, set()).passed
    assert garbage_refused(status, 4, 3, 100, set()).passed  # one was lost on the wire
    assert not garbage_refused(status, 2, 3, 100, set()).passed
    assert not garbage_refused(status, 3, 2, 100, set()).passed
    assert not garbage_refused(status, 3, 3, 100, {"monkey"}).passed
    assert not garbage_refused(None, 3, 3, 100, set()).passed
    status.records_dropped = 1
    assert not garbage_refused(status, 3, 3, 100, set()).passed
