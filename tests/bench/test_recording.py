"""How `bench recording` counts, and what `bench spy` sends."""

import threading
import time
from pathlib import Path

import lcm
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.robot_state_t import robot_state_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem import recording_bench
from tandem.processes import free_lcm_url
from tandem.spy import bench
from tandem.spy.live import LiveSource
from tandem.spy.model import Model

TICKS = 1000


def recorded(path: Path, lost: set[tuple[int, int]], again: int = 0, beside: int = 0) -> Path:
    """Two episodes of 1 kHz; `again`: messages that come twice; `beside`: messages of another program."""
    log = lcm.EventLog(str(path), "w", overwrite=True)
    for i in range(beside):
        state = robot_state_t()
        state.tick = i
        log.write_event(i, "BENCH_0_ROBOT_STATE", state.encode())
    for episode in range(2):
        for step in range(5):  # the last one is not published
            world = world_state_t()
            world.episode, world.step = episode, step
            if (episode, step) not in lost:
                log.write_event(step, "WORLD_STATE", world.encode())
        for tick in range(TICKS):
            state = robot_state_t()
            state.episode, state.tick = episode, tick
            if (episode, tick) not in lost:
                log.write_event(1000 * tick, "ROBOT_STATE", state.encode())
            if tick < again:
                log.write_event(1000 * tick, "ROBOT_STATE", state.encode())
        end = episode_end_t()
        end.episode = episode
        log.write_event(1000 * TICKS, "EPISODE_END", end.encode())
    log.close()
    return path


def test_what_lcm_logger_lost_is_counted_wherever_it_lies(tmp_path: Path) -> None:
    own = recorded(tmp_path / "own.lcm", set())
    lost = {(0, 0), (0, 3), (1, 1), (0, 4), (1, 4)}  # (0, 4), (1, 4): the last states, which nobody sends
    other = {"other": recorded(tmp_path / "other.lcm", lost, beside=95)}
    value = recording_bench.count(own, other, sent_beside=100)
    assert value["own"]["lost"] == 0 and value["own"]["channels"]["ROBOT_STATE"] == {
        "count": 2 * TICKS,
        "gaps": 0,
    }
    there = value["others"]["other"]["channels"]
    assert (there["WORLD_STATE"]["sent"], there["WORLD_STATE"]["lost"]) == (8, 3)
    assert there["beside, 1 kHz"] == {"sent": 100, "recorded": 95, "lost": 5}
    assert there["EPISODE_END"]["sent"] == 1  # the last one ends with the run
    assert value["others"]["other"]["lost"] == 8


def test_a_hole_in_the_own_log_is_counted_and_a_message_that_comes_twice_is_none(tmp_path: Path) -> None:
    own = recorded(tmp_path / "own.lcm", {(1, 300), (1, 301), (1, 600)}, again=3)
    assert recording_bench.count(own, {}, 0)["own"]["lost"] == 3


def test_missing_event_numbers_are_holes(tmp_path: Path) -> None:
    path = recorded(tmp_path / "log.lcm", set())
    data = path.read_bytes()
    at = data.index(b"\xed\xa1\xda\x01", 1000)  # some event
    size = data.index(b"\xed\xa1\xda\x01", at + 1) - at
    path.write_bytes(data[:at] + data[at + size :])
    assert recording_bench.event_numbers_missing(path) == 1


def test_the_generator_numbers_every_message_of_every_channel() -> None:
    url = free_lcm_url()
    source, model = LiveSource(url), Model()
    load = bench.Load(channels=10, hz=200, seconds=0.5)
    sender = threading.Thread(target=bench.generate, args=(url, load))
    sender.start()
    sender.join()
    deadline = time.monotonic() + 10.0
    while sum(c.count for c in model.channels.values()) < load.messages and time.monotonic() < deadline:
        time.sleep(0.05)
        model.take(source.poll())
    source.close()
    rows = model.rows()
    assert [row.count for row in rows] == [100] * 10
    assert all(row.gaps == 0 and row.undecodable == 0 and row.latency_ms for row in rows)
    assert len({row.type for row in rows}) == 4
