"""The figures of one channel, from raw messages."""

import pytest
from spy_messages import end, robot, status, world
from tandem_lcm.tandem.action_chunk_t import action_chunk_t
from tandem_lcm.tandem.episode_step_t import episode_step_t

from tandem.spy import layout
from tandem.spy.channel import Channel
from tandem.wire import CHANNELS

MS = 1000


def fed(name: str, messages: list[bytes], every_us: int = 10 * MS, batch: int = 7) -> Channel:
    channel = Channel(name)
    times = [i * every_us for i in range(len(messages))]
    for i in range(0, len(messages), batch):
        channel.take(times[i : i + batch], messages[i : i + batch])
    return channel


def test_members_lie_where_the_decoder_finds_them() -> None:
    for message_type in CHANNELS.values():
        message = message_type()
        found = layout.of_fingerprint(message_type._get_packed_fingerprint())
        assert found is not None
        lengths = {n for dimensions in message_type.__dimensions__ for n in dimensions or ()}
        numbered = {
            name: number
            for number, name in enumerate(found.members, 1)
            if isinstance(getattr(message, name), int) and name not in lengths
        }
        for name, number in numbered.items():
            setattr(message, name, number)
        data = message.encode()
        for name, number in numbered.items():
            assert found.read(name, [data]).tolist() == [number], (message_type, name)
        assert found.size in (None, len(data))


def test_rate_jitter_and_bandwidth_of_an_even_channel() -> None:
    data = robot(0, 0).encode()
    row = fed("ROBOT_STATE", [data] * 300).row(2990 * MS, expected_hz=100.0)
    assert (row.count, row.type, row.undecodable) == (300, "robot_state_t", 0)
    assert row.rate_hz == pytest.approx(100.0)
    assert row.jitter_ms == 0.0 and not row.slow
    assert row.bytes_per_s == pytest.approx(100 * len(data))


def test_jitter_is_what_99_percent_of_the_intervals_keep() -> None:
    channel = Channel("WORLD_STATE")
    times = [i * 10 * MS + (4 * MS if i % 10 == 5 else 0) for i in range(200)]
    channel.take(times, [world(0, i).encode() for i in range(200)])
    assert channel.row(times[-1], None).jitter_ms == pytest.approx(4.0)


def test_a_channel_that_falls_silent_slows_down_and_ages() -> None:
    channel = fed("ROBOT_STATE", [robot(0, 10 * i).encode() for i in range(300)])
    row = channel.row(2990 * MS + 20_000 * MS, expected_hz=100.0)
    assert row.rate_hz is not None and row.rate_hz < 1.0
    assert row.slow and row.age_s == pytest.approx(20.0)


@pytest.mark.parametrize("batch", [1, 7, 1000])
def test_missing_numbers_are_counted_whatever_their_usual_step(batch: int) -> None:
    ticks = [tick for tick in range(10, 3010, 10) if tick not in (500, 510, 520, 1700)]
    channel = fed("ROBOT_STATE", [robot(0, tick).encode() for tick in ticks], batch=batch)
    assert channel.gaps == 4


@pytest.mark.parametrize("batch", [1, 7, 1000])
def test_a_new_episode_and_messages_sent_again_are_no_gaps(batch: int) -> None:
    steps = [(0, i) for i in range(20)] + [(0, 5), (0, 6)] + [(0, 20)] + [(1, i) for i in range(20)]
    channel = fed("WORLD_STATE", [world(*step).encode() for step in steps], batch=batch)
    assert channel.gaps == 0
    assert fed("CONTROLLER_STATUS", [status().encode()]).gaps is None  # carries no number


def test_what_does_not_decode_is_counted_and_never_shown() -> None:
    good = robot(3, 10).encode()
    channel = fed("ROBOT_STATE", [good, good[:-1], b"", b"\0" * 600, world(0, 0).encode()])
    assert (channel.count, channel.undecodable) == (5, 4)
    assert channel.latest == good and channel.decode_latest().episode == 3

    # of variable size: cut off inside the array that its length announces
    chunk = action_chunk_t()
    chunk.horizon, chunk.policy_chunk = 2, [[0.5] * 7] * 2
    data = chunk.encode()
    assert fed("ACTION_CHUNK", [data, data[:-8], data[:20]]).undecodable == 2
    step = episode_step_t()
    step.n_observation, step.observation, step.next_observation = 2, [1.0, 2.0], [3.0, 4.0]
    assert fed("EPISODE_STEP", [step.encode()]).undecodable == 0


def test_a_channel_with_a_suffix_is_known_by_its_messages_and_a_foreign_one_is_not() -> None:
    assert fed("ROBOT_STATE_B", [robot(0, 10).encode()]).row(0, None).type == "robot_state_t"
    foreign = fed("SOMEBODY_ELSE", [b"01234567 what is this"] * 3)
    assert foreign.row(0, None).type == "?" and foreign.undecodable == 3 and foreign.gaps is None


def test_latency_is_told_only_where_both_ends_share_a_clock() -> None:
    message = end(0)
    message.utime = 1_000_000
    channel = Channel("EPISODE_END")
    channel.take([1_002_000], [message.encode()], live=True)
    latency = channel.row(1_002_000, None).latency_ms
    assert latency is not None and latency["p99"] == pytest.approx(2.0)
    simulated = Channel("EPISODE_END")
    simulated.take([900_000_000_000], [message.encode()], live=True)
    assert simulated.row(900_000_000_000, None).latency_ms is None
