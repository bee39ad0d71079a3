"""Terminal codes -> keys: nothing that is not a key may become one."""

import random

import pytest

from tandem.teleop.keys import Key, KeyDecoder, Kind


def decode(*pieces: bytes, gap_s: float = 0.0) -> list[Key]:
    decoder = KeyDecoder()
    return [key for i, piece in enumerate(pieces) for key in decoder.feed(piece, i * gap_s)]


@pytest.mark.parametrize(
    ("data", "key"),
    [
        (b"w", Key("w")),
        (b"W", Key("w")),  # caps lock
        (b" ", Key("space")),
        (b"\r", Key("enter")),
        (b"\x7f", Key("backspace")),
        (b"\x03", Key("ctrl+c")),
        (b"\x1b[A", Key("up")),
        (b"\x1bOA", Key("up")),  # application mode
        (b"\x1b[5~", Key("pageup")),
        ("ü".encode(), Key("ü")),
        (b"\x1b[119;1:1u", Key("w", Kind.press)),
        (b"\x1b[119;1:2u", Key("w", Kind.repeat)),
        (b"\x1b[119;1:3u", Key("w", Kind.release)),
        (b"\x1b[119u", Key("w", Kind.press)),
        (b"\x1b[99;5u", Key("ctrl+c")),
        (b"\x1b[99;69u", Key("ctrl+c")),  # with caps lock
        (b"\x1b[13u", Key("enter")),
        (b"\x1b[61:43;2u", Key("=")),  # shift and = is +
        (b"\x1b[1;1:3A", Key("up", Kind.release)),
        (b"\x1b[5;1:2~", Key("pageup", Kind.repeat)),
        (b"\x1b[I", Key("focus")),
        (b"\x1b[O", Key("blur")),
        (b"\x1b[?0u", Key("kitty")),
    ],
)
def test_a_key_is_known_however_the_terminal_cuts_it(data: bytes, key: Key) -> None:
    assert decode(data) == [key]
    assert decode(*(data[i : i + 1] for i in range(len(data)))) == [key]
    assert decode(b"x" + data, b"v") == [Key("x"), key, Key("v")]


@pytest.mark.parametrize(
    "data",
    [
        b"\x1b[200~wasd1x\r\x1b[201~",  # pasted text
        b"\x1b[200~w\x1b[A\x1b[201~",
        b"\x1b[?62;22c",  # who the terminal is
        b"\x1b[<0;10;20M",  # a mouse
        b"\x1b[24;80R",
        b"\x1b[57441;2:1u",  # shift alone
        b"\x1b[119;1:9u",  # no such kind of event
        b"\x1b[99999999999999999999u",
        b"\x1bw",  # alt and w
        b"\xff\xfe",
    ],
)
def test_what_is_no_key_is_swallowed_whole(data: bytes) -> None:
    assert decode(data, b"v") == [Key("v")]
    assert decode(*(data[i : i + 1] for i in range(len(data))), b"v") == [Key("v")]


def test_the_escape_key_does_not_eat_the_next_one() -> None:
    assert decode(b"\x1b", b"w", gap_s=0.2) == [Key("w")]
    assert decode(b"\x1b", b"[A", gap_s=0.01) == [Key("up")]


def test_no_bytes_break_the_decoder_and_cutting_changes_nothing() -> None:
    draw = random.Random(7)
    alphabet = [
        b"\x1b",
        b"[",
        b"O",
        b";",
        b":",
        b"1",
        b"3",
        b"u",
        b"~",
        b"A",
        b"w",
        b"\xc3",
        b"\xbc",
        b"200~",
        b"\x1b[201~",
    ]
    for _ in range(3000):
        data = b"".join(draw.choices(alphabet, k=draw.randrange(1, 20)))
        cuts = sorted(draw.randrange(len(data) + 1) for _ in range(3))
        pieces = [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]
        assert decode(*pieces) == decode(data), data
