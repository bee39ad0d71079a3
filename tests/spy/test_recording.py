"""A log as a source: its order, its pauses, seeking, and a tail that was cut off."""

import time
from pathlib import Path

import pytest
from spy_messages import SLOT_US, STEPS, episodes, write

from tandem.spy import once
from tandem.spy.model import Batch, Model
from tandem.spy.recording import RecordedSource, Recording


def taken(batch: Batch, channel: str) -> int:
    return len(batch.channels.get(channel, ([], []))[1])


def played(source: RecordedSource, seconds: float) -> Batch:
    """What so many seconds of the wall clock bring, without waiting for them."""
    source._polled = time.monotonic() - seconds
    return source.poll()


@pytest.fixture
def source(log: Path) -> RecordedSource:
    found = RecordedSource(log, None)
    found.poll()
    yield found
    found.close()


def test_a_log_plays_in_its_own_time_and_leaves_the_pauses_out(source: RecordedSource) -> None:
    batch = played(source, 1.0)
    assert taken(batch, "ROBOT_STATE") == pytest.approx(100, abs=3)
    # two seconds of each slot of twelve are motion: three more seconds reach into the third episode
    batch = played(source, 3.05)
    assert taken(batch, "EPISODE_END") == 2
    assert source.position_us == pytest.approx(2 * SLOT_US + 50_000, abs=30_000)
    model = Model(robot_time=True)
    model.take(batch)
    row = next(row for row in model.rows() if row.channel == "ROBOT_STATE")
    assert row.rate_hz == pytest.approx(100.0, rel=0.1) and row.gaps == 0


def test_speed_is_bounded_and_multiplies_time(source: RecordedSource) -> None:
    for _ in range(20):
        source.faster()
    assert source.speed == 64.0
    batch = played(source, 10.0)
    assert taken(batch, "EPISODE_END") == 4 and source.ended
    for _ in range(20):
        source.slower()
    assert source.speed == 0.0625


def test_a_pause_holds_and_a_step_goes_to_the_next_policy_step(source: RecordedSource) -> None:
    played(source, 0.45)
    source.paused = True
    assert played(source, 5.0).channels == {}
    for _ in range(3):
        source.step()
        batch = source.poll()
        assert taken(batch, "WORLD_STATE") == 1
        assert taken(batch, "ROBOT_STATE") <= 10
    # over the pause between two episodes as well
    source.seek(2 * SLOT_US - 1_000_000)
    source.poll()
    source.step()
    assert taken(source.poll(), "WORLD_STATE") == 1
    assert source.position_us == 2 * SLOT_US


def test_a_pause_between_episodes_is_not_crossed_while_paused(source: RecordedSource) -> None:
    source.seek(2_000_000)
    source.paused = True
    source.poll()
    assert source.poll().channels == {} and source.position_us == 2_000_000


def test_seeking_shows_what_led_to_the_moment_and_tells_the_episodes_before(source: RecordedSource) -> None:
    source._reader.join()
    before = source.seek(3 * SLOT_US + 1_000_000)
    assert [end.episode for end in before] == [0, 1, 2]
    batch = source.poll()
    assert source.position_us == 3 * SLOT_US + 1_000_000
    assert taken(batch, "WORLD_STATE") == 11
    assert source.seek(-5) == [] and source.position_us == 0
    assert taken(played(source, 0.5), "ROBOT_STATE") == 0  # the moment itself first
    assert taken(played(source, 0.5), "ROBOT_STATE") == pytest.approx(50, abs=3)


def test_episodes_are_found_in_both_directions(source: RecordedSource) -> None:
    source._reader.join()
    source.seek(SLOT_US + 500_000)
    assert source.episode_at(+1) == SLOT_US + 2_000_001
    assert source.episode_at(-1) == source.recording.begin_us
    assert source.episode_at(+99) is not None


def test_what_is_appended_while_we_watch_is_read(tmp_path: Path) -> None:
    path = write(tmp_path / "log.lcm", episodes(1))
    whole = write(tmp_path / "whole.lcm", episodes(2)).read_bytes()
    source = RecordedSource(path, None)
    played(source, 100.0)
    assert source.ended
    with path.open("ab") as file:
        file.write(whole[path.stat().st_size :])
    assert not source.ended
    assert taken(played(source, 100.0), "EPISODE_END") == 1
    source.close()


def test_a_cut_off_tail_ends_the_log_and_damage_is_a_sentence(log: Path, tmp_path: Path) -> None:
    data = log.read_bytes()
    cut = tmp_path / "cut.lcm"
    cut.write_bytes(data[: len(data) // 2])
    model = Model(robot_time=True)
    recording = Recording(cut)
    once.read(recording, model)
    recording.close()
    assert 0 < model.channels["ROBOT_STATE"].count < 4 * STEPS * 10
    assert once.figures("cut", model)["undecodable"] == 0
    (tmp_path / "empty.lcm").write_bytes(b"")
    with pytest.raises(ValueError, match="holds no whole event"):
        Recording(tmp_path / "empty.lcm")
