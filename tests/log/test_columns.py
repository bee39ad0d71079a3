"""Many messages decoded at once are what the types' own decoders say, one by one."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from handmade import encoded, end, state

from tandem.log import EventLog
from tandem.wire import CHANNELS, decode

Write = Callable[..., Path]
_RANGES = {"int8_t": 100, "int16_t": 30_000, "int32_t": 2_000_000_000, "int64_t": 2**62}


def random_message(message_type: Any, generator: np.random.Generator, length: int) -> Any:
    """Every field random; arrays of variable length and strings as long as asked."""
    message = message_type()
    counts = {d for dims in message_type.__dimensions__ if dims for d in dims if isinstance(d, str)}

    def value(kind: str) -> Any:
        if kind in _RANGES:
            return int(generator.integers(-_RANGES[kind], _RANGES[kind]))
        if kind == "float":
            return float(np.float32(generator.standard_normal()))
        if kind == "double":
            return float(generator.standard_normal())
        if kind == "string":
            return "ü" + "x" * length
        return random_message(
            getattr(importlib.import_module(kind), kind.rsplit(".", 1)[1]), generator, length
        )

    def array(kind: str, shape: list[int]) -> Any:
        if kind == "byte":
            return generator.bytes(shape[0])
        return [array(kind, shape[1:]) for _ in range(shape[0])] if shape else value(kind)

    for name, kind, dimensions in zip(
        message_type.__slots__, message_type.__typenames__, message_type.__dimensions__, strict=True
    ):
        shape = [length if isinstance(d, str) else d for d in dimensions or ()]
        setattr(message, name, length if name in counts else array(kind, shape))
    return message


@pytest.mark.parametrize("channel", sorted(CHANNELS))
def test_columns_of_every_type_are_what_its_decoder_says(write: Write, channel: str) -> None:
    generator = np.random.default_rng(5)
    lengths = [3, 3, 0, 7, 3]  # several shapes, in turns
    messages = [random_message(CHANNELS[channel], generator, length) for length in lengths]
    names = CHANNELS[channel].__slots__
    log = EventLog(write(*encoded(*messages, end(0)) if channel != "EPISODE_END" else encoded(*messages)))
    columns = log.columns(channel, *names)
    assert columns["row"].tolist() == [0, 1, 2, 3, 4]
    for i, message in enumerate(messages):
        expected = decode(channel, message.encode())
        for name in names:
            found, wanted = columns[name][i], getattr(expected, name)
            wanted = list(wanted) if isinstance(wanted, bytes) else wanted
            if isinstance(wanted, list) and wanted and hasattr(wanted[0], "__slots__"):
                for record, part in zip(found, wanted, strict=True):  # structs are records
                    for inner in part.__slots__:
                        np.testing.assert_array_equal(record[inner], getattr(part, inner), err_msg=inner)
            else:
                shape = np.shape(wanted) if np.size(wanted) else np.shape(found)
                np.testing.assert_array_equal(found, np.reshape(wanted, shape), err_msg=name)


def test_message_that_does_not_decode_is_left_out_and_counted(write: Write) -> None:
    pieces = encoded(*(state(tick) for tick in range(5)))
    other_type = pieces[1].replace(state(1).encode()[:8], b"otherone")
    header = 28 + len("ROBOT_STATE")
    short = bytearray(pieces[3][:-8])  # the right fingerprint and not the whole message
    short[24:28] = (len(short) - header).to_bytes(4, "big")
    log = EventLog(write(pieces[0], other_type, pieces[2], bytes(short), pieces[4]))
    assert log.columns("ROBOT_STATE", "tick")["tick"].tolist() == [0, 2, 4]
    assert log.index.readable.tolist() == [1, 0, 1, 1, 1]


def test_columns_of_some_rows_only_and_of_an_absent_channel(write: Write) -> None:
    log = EventLog(write(*encoded(*(state(tick) for tick in range(5)))))
    some = log.columns("ROBOT_STATE", "tick", "F_ext_W", rows=np.array([1, 3]))
    assert some["tick"].tolist() == [1, 3] and some["F_ext_W"][:, 5].tolist() == [-1.0, -3.0]
    absent = log.columns("EPISODE_END", "episode")
    assert len(absent["row"]) == len(absent["episode"]) == 0


def test_episodes_know_their_events(write: Write) -> None:
    log = EventLog(write(*encoded(state(0), state(1), end(4), end(4), state(2), end(5), state(3))))
    episodes = log.episodes
    assert episodes.number.tolist() == [4, 5]
    assert list(zip(episodes.first.tolist(), episodes.last.tolist(), strict=True)) == [(0, 2), (3, 5)]
    assert episodes.of(np.array([0, 2, 3, 6])).tolist() == [0, 0, 1, 2]
