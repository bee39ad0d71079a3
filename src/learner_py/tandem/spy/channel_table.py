"""The table of channels: its columns, their texts, what fits into how many characters; and the same as JSON."""

import dataclasses
from dataclasses import dataclass
from typing import Any

from rich.table import Table
from rich.text import Text

from tandem.spy.channel import Row


@dataclass(frozen=True)
class Column:
    title: str
    width: int
    wide: bool = False  # only where there is room
    left: bool = False


COLUMNS = (
    Column("channel", 18, left=True),
    Column("type", 20, wide=True, left=True),
    Column("count", 8),
    Column("Hz", 7),
    Column("exp.", 5),
    Column("jitter ms", 9),
    Column("gaps", 5),
    Column("kB/s", 7),
    Column("age s", 6),
    Column("late ms", 8, wide=True),
    Column("bad", 4),
)
NARROW = 80  # characters that the narrow table needs, its margins included
WIDE = NARROW + sum(column.width + 1 for column in COLUMNS if column.wide)


def columns(width: int) -> list[Column]:
    """Those that fit into so many characters."""
    return [column for column in COLUMNS if width >= WIDE or not column.wide]


def cells(row: Row, width: int) -> list[Text]:
    """A line's texts, one for each of `columns(width)`."""
    texts = {
        "channel": Text(row.channel),
        "type": Text(row.type, style="dim"),
        "count": Text(_count(row.count)),
        "Hz": Text(_number(row.rate_hz), style="yellow" if row.slow else ""),
        "exp.": Text(_number(row.expected_hz), style="dim"),
        "jitter ms": Text("" if row.jitter_ms is None else f"{row.jitter_ms:.2f}"),
        "gaps": Text("" if row.gaps is None else _count(row.gaps), style="bold red" if row.gaps else ""),
        "kB/s": Text(_number(row.bytes_per_s / 1e3)),
        "age s": Text(_number(row.age_s)),
        "late ms": Text("" if row.latency_ms is None else f"{row.latency_ms['p99']:.2f}"),
        "bad": Text(_count(row.undecodable), style="bold red" if row.undecodable else "dim"),
    }
    found = []
    for column in columns(width):
        text = texts[column.title]
        text.truncate(column.width, overflow="ellipsis")
        if not column.left:
            text.align("right", column.width)
        found.append(text)
    return found


def table(rows: list[Row], width: int) -> Table:
    """All of it, for a page or a pipe."""
    shown = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    for column in columns(width):
        shown.add_column(column.title, justify="left" if column.left else "right", no_wrap=True)
    for row in rows:
        shown.add_row(*cells(row, width))
    return shown


def as_json(rows: list[Row]) -> list[dict[str, Any]]:
    return [dataclasses.asdict(row) for row in rows]


def _count(n: int) -> str:
    if n < 1_000_000:
        return str(n)
    return f"{n / 1e6:.2f}M" if n < 1e9 else f"{n / 1e9:.2f}G"


def _number(value: float | None) -> str:
    if value is None:
        return ""
    if value >= 1000:
        return f"{value:.0f}"
    return f"{value:.1f}" if value >= 10 or value == 0 else f"{value:.2f}"
