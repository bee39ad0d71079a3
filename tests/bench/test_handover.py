"""The counting of `tandem bench handover`, on a log of which every tick is known."""

import math
from pathlib import Path

import lcm
import pytest
from tandem_lcm.tandem.action_chunk_t import action_chunk_t
from tandem_lcm.tandem.control_tick_t import control_tick_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.policy_announce_t import policy_announce_t
from tandem_lcm.tandem.robot_state_t import robot_state_t
from tandem_lcm.tandem.teleop_command_t import teleop_command_t

from tandem.cli.bench_handover import caused, not_reached
from tandem.cli.handover_count import Phase, count, more_often, read, ticks_beyond
from tandem.wire import CHANNEL_OF


class Arm:
    """Writes what a controller would: alpha in ramps of 50 and 100 ticks; 1 ms a tick and a missed one."""

    def __init__(self, path: Path) -> None:
        self.log = lcm.EventLog(str(path), "w", overwrite=True)
        self.now = 1_000_000  # us
        self.tick = self.episode = 0
        self.share = 0  # of 100
        self.engaged = False
        self.torque = 0.0

    def write(self, message) -> None:
        message.utime = self.now
        self.log.write_event(self.now, CHANNEL_OF[type(message)], message.encode())

    def ticks(self, n: int, missed: int = 0, jump: float = 0.0) -> None:
        """missed, jump: of the first one."""
        for i in range(n):
            self.now += 1000 * (1 + (missed if i == 0 else 0))
            self.share = min(100, self.share + 2) if self.engaged else max(0, self.share - 1)
            tick, state = control_tick_t(), robot_state_t()
            tick.tau_received = [0.0] * 6 + [self.torque]
            self.torque += jump if i == 0 else 0.0
            tick.tick, tick.episode, tick.missed_cycles = self.tick, self.episode, missed if i == 0 else 0
            tick.tau_commanded = [0.0] * 6 + [self.torque]
            state.tick, state.alpha = self.tick, self.share / 100
            self.write(tick)
            self.write(state)
            self.tick += 1

    def operator(self, engaged: bool) -> None:
        message = teleop_command_t()
        message.engaged = int(engaged)
        self.engaged = engaged
        self.write(message)

    def policy(self, version: int, announced: bool = True) -> None:
        """Its chunk takes over in the next tick."""
        announce, chunk = policy_announce_t(), action_chunk_t()
        announce.version = chunk.policy_version = version
        if announced:
            self.write(announce)
        self.write(chunk)

    def end(self, fault: int = 0) -> None:
        end = episode_end_t()
        end.episode, end.fault = self.episode, fault
        self.write(end)
        self.tick, self.episode, self.share, self.engaged = 0, self.episode + 1, 0, False
        self.now += 50_000  # the reset


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "log.lcm"


@pytest.fixture
def arm(path: Path) -> Arm:
    return Arm(path)


def read_all(arm: Arm, path: Path):
    arm.log.close()
    return read(path)


def test_swap_counts_when_its_chunk_takes_over_and_not_when_announced_or_repeated(arm, path):
    arm.policy(1)
    arm.ticks(100)
    arm.policy(1, announced=False)
    arm.ticks(100)
    arm.policy(3)  # 2 was overtaken
    arm.ticks(1)
    swapped_at = arm.now
    arm.end()
    arm.policy(3, announced=False)
    arm.ticks(10)
    announce = policy_announce_t()
    announce.version = 4
    arm.write(announce)  # in force, but no chunk of it was taken
    arm.ticks(10)
    found = read_all(arm, path)
    assert found.swaps == [swapped_at]
    assert found.announced_in_force == 2


def test_handover_counts_when_alpha_has_reached_its_height_and_is_back_at_nothing(arm, path):
    arm.ticks(5)
    arm.operator(True)
    arm.operator(True)  # said ten times, engaged once
    arm.ticks(44)
    arm.operator(False)  # at 0.88
    arm.ticks(100)
    arm.operator(True)
    arm.ticks(45)
    arm.operator(False)
    arm.ticks(30)
    arm.operator(True)  # on the way down: still the same hand-over
    arm.ticks(60)
    arm.operator(False)
    arm.ticks(100)
    found = read_all(arm, path)
    assert found.handovers == 1
    assert found.ticks_to_authority == [45]
    assert len(found.edges) == 6


def test_handover_that_the_end_of_the_episode_cuts_off_does_not_count(arm, path):
    arm.operator(True)
    arm.ticks(60)
    arm.end(fault=6)
    arm.ticks(10)
    arm.operator(True)  # the hand is still there, and engages anew
    arm.ticks(50)
    arm.operator(False)
    arm.ticks(100)
    found = read_all(arm, path)
    assert found.handovers == 1 and found.ticks_to_authority == [45, 45]
    assert len(found.edges) == 3
    assert found.episodes == 1 and found.faults == [6]


def test_stall_belongs_to_the_phase_and_to_the_event_that_it_began_in(arm, path):
    arm.policy(1)
    begin = arm.now
    arm.ticks(100)
    arm.policy(2)
    arm.ticks(20)
    arm.ticks(1, missed=30)  # begins 19 ms after the swap, ends 50 ms after it
    arm.ticks(10)
    arm.ticks(1, missed=2)  # too late to be the swap's
    arm.ticks(5)
    middle = arm.now + 500
    arm.ticks(1, missed=4)  # its beginning lies in the busy phase, its end in the quiet one
    arm.ticks(99)
    arm.ticks(1, missed=1)
    arm.ticks(99)
    phases = [Phase(True, begin, middle), Phase(False, middle, arm.now + 1)]
    value = count(read_all(arm, path), phases)
    assert value["missed_ticks"] == 37
    busy = value["busy"]
    assert (busy["cycles"], busy["missed_ticks"], busy["stalls"]) == (137 + 36, 36, 3)
    assert busy["longest_stall_cycles"] == 30
    assert value["quiet"]["cycles"] == 200 + 1 and value["quiet"]["stalls"] == 1
    near = value["within_20ms_after_event"]
    assert (near["cycles"], near["missed_ticks"], near["stalls"]) == (20 + 30, 30, 1)
    assert value["busy"]["missed_ticks_beyond_quiet"] == pytest.approx(36 - 173 / 201)


def test_what_is_missed_right_after_an_event_tick_is_counted_apart(arm, path):
    arm.ticks(10)
    arm.operator(True)
    arm.ticks(1, missed=3)  # before it took effect
    arm.ticks(1, missed=2)
    arm.ticks(1, missed=4)  # the tick after that is nobody's
    value = count(read_all(arm, path), [])
    assert value["event_ticks"]["cycles"] == 1 + 2 and value["event_ticks"]["missed_ticks"] == 2


def test_excess_counts_as_caused_only_when_it_is_no_chance():
    def value(excess: float, p: float, directly: tuple[float, float] = (0.0, 1.0)) -> dict:
        def part(beyond: float, p_value: float) -> dict:
            return {"missed_ticks_beyond_quiet": beyond, "stalls_p_value": p_value}

        return {
            "busy": part(excess, p),
            "event_ticks": part(*directly),
            "within_20ms_after_event": part(-1.0, 0.7),
        }

    assert caused(value(7.2, 0.2)) == 0
    assert caused(value(7.2, 0.01)) == 8
    assert caused(value(-3.0, 0.01)) == 0
    assert caused(value(-3.0, 0.9, directly=(2.5, 0.001))) == 3


def test_work_between_phases_is_in_neither(arm, path):
    arm.ticks(10)
    arm.ticks(10, missed=5)
    phases = [Phase(True, 0, 1_001_000), Phase(False, arm.now + 1000, arm.now + 2000)]
    value = count(read_all(arm, path), phases)
    assert value["missed_ticks"] == 5
    assert value["busy"]["cycles"] == value["quiet"]["cycles"] == 0
    assert value["busy"]["stalls_p_value"] == 1.0


def test_torque_jump_is_taken_within_an_episode(arm, path):
    arm.ticks(10)
    arm.ticks(10, jump=0.75)
    arm.policy(1)
    arm.ticks(10)
    arm.policy(2)
    arm.ticks(10, jump=-0.5)
    arm.end()
    arm.torque = 3.0  # the brakes did that
    arm.ticks(1, jump=0.25)  # against what the robot got last
    value = count(read_all(arm, path), [])
    assert value["largest_torque_jump_Nm"] == pytest.approx(0.75)
    assert value["largest_torque_jump_within_20ms_Nm"] == pytest.approx(0.5)


def test_poisson_test_is_the_binomial_tail():
    def part(stalls: int, cycles: int) -> dict[str, int]:
        return {"stalls": stalls, "cycles": cycles}

    assert more_often(part(0, 100), part(0, 100)) == 1.0
    assert more_often(part(3, 100), part(0, 100)) == pytest.approx(1 / 8)
    assert more_often(part(2, 100), part(1, 300)) == pytest.approx(3 * 0.25**2 * 0.75 + 0.25**3)
    assert more_often(part(500, 1000), part(500, 1000)) == pytest.approx(
        0.5 + 0.5 * math.comb(1000, 500) / 2**1000
    )
    assert more_often(part(60, 1000), part(20, 1000)) < 1e-5


def test_ticks_beyond_a_limit_are_those_of_its_bucket_and_later():
    histogram = {"bucket_us": 0.2, "counts": [9] * 4999 + [7, 3, 2], "max_us": 1000.5}
    assert ticks_beyond(histogram, 1000.0) == 5
    assert ticks_beyond({"bucket_us": 0.2, "counts": [9] * 100, "max_us": 20.0}, 1000.0) == 0


def test_each_missed_target_is_said():
    good = {
        "swaps": 5, "swaps_asked": 5, "handovers": 6, "handovers_asked": 5, "missed_ticks_caused": 0, "faults": [],
        "largest_torque_jump_Nm": 1.0, "ticks_to_authority": {"max": 45}, "records_dropped": 0,
    }  # fmt: skip
    assert not_reached(good) == []
    bad = {
        "swaps": 4, "handovers": 4, "missed_ticks_caused": 1, "faults": [6], "largest_torque_jump_Nm": 1.01,
        "ticks_to_authority": {"max": 51}, "records_dropped": 1,
    }  # fmt: skip
    for name, wrong in bad.items():
        assert len(not_reached({**good, name: wrong})) == 1, name
