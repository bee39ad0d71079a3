"""The screen of a person at the controls."""

import math
from dataclasses import dataclass, field
from typing import Any

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text
from tandem_lcm.tandem.controller_status_t import controller_status_t

from tandem.teleop.watch import Watch, object_in_goal
from tandem.words import PHASES, STATES

BAR, SHORT_BAR = 24, 6  # characters
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_KEY_COLUMNS = 3
GRADES = ("fresh", "hold", "damp", "stop")
SOURCES = ("policy", "operator", "link")


@dataclass
class View:
    """What the session adds to what the controller tells."""

    title: str
    engaged: bool = False
    speed: float = 0.0
    held: str = ""  # keys or sticks
    note: str = ""  # the last thing that happened
    warning: str = ""
    help: list[tuple[str, str]] = field(default_factory=list)
    training: dict[str, str] = field(default_factory=dict)


def bar(share: float, encoding: str = "utf-8", length: int = BAR) -> str:
    """[0, 1] as a bar; more than 1 fills it."""
    filled = round(length * min(1.0, max(0.0, share))) if math.isfinite(share) else 0
    full, empty = ("█", "·") if encoding.lower().startswith("utf") else ("#", ".")
    return full * filled + empty * (length - filled)


def rows(view: View, watch: Watch, encoding: str = "utf-8") -> list[tuple[str, Text]]:
    """Label and text, top to bottom."""
    shown = [("arm", _mode(watch))]
    if fault := watch.fault():
        shown.append(("fault", Text(fault, style="bold red")))
    if view.warning:
        shown.append(("device", Text(view.warning, style="bold yellow")))
    you = Text("ENGAGED", style="bold green") if view.engaged else Text("hands off", style="dim")
    you.append(f"   speed {100 * view.speed:.0f} %   {view.held}", style="not bold")
    shown.append(("you", you))
    if watch.robot is not None:
        alpha = watch.robot.alpha
        shown.append(("authority", Text(f"{bar(alpha, encoding)} {alpha:.2f}")))
        shown += forces(watch.robot, encoding)
    if watch.world is not None:
        (x, y, z), turn, tilt = object_in_goal(watch.world)
        pose = f"x {1000 * x:+6.1f}  y {1000 * y:+6.1f}  z {1000 * z:+6.1f} mm from goal"
        pose += f"  turn {math.degrees(turn):+.1f}  tilt {math.degrees(tilt):.1f} deg"
        shown.append(("object", Text(pose)))
        masked = [axis for axis, limit in zip(_AXES, watch.world.action_limit, strict=True) if limit == 0.0]
        if masked:
            shown.append(("masked", Text(f"{' '.join(masked)}, by the task", style="dim")))
    shown += [(label, Text(text)) for label, text in view.training.items()]
    shown.append(("", Text(view.note, style="cyan")))
    return shown


def _mode(watch: Watch) -> Text:
    if watch.silent:
        what = "silent: it has ended or hangs" if watch.status is not None else "not heard yet"
        return Text(f"controller {what}", style="yellow")
    status = watch.status
    text = f"{STATES.get(status.state, '?')}, {PHASES.get(status.phase, '?')}, episode {status.episode}"
    if watch.world is not None and status.state == controller_status_t.RUNNING:
        text += f", step {watch.world.step} of {watch.world.max_steps}"
    stale = [
        f"{source} {GRADES[grade]}"
        for source, grade in zip(SOURCES, status.source_grade, strict=True)
        if 0 < grade < len(GRADES)
    ]
    if stale:
        text += f"   silent: {', '.join(stale)}"
    if status.waiting_for:
        text += f"\nwaiting for {status.waiting_for}"
    return Text(text, style="bold red" if status.state == controller_status_t.HALTED else "bold")


def forces(robot: Any, encoding: str = "utf-8") -> list[tuple[str, Text]]:
    """Force and moment on the tool against the bound of the impedance law, axis by axis."""
    shown = []
    for label, unit, first in (("force", "N", 0), ("moment", "N m", 3)):
        text = Text()
        for i, axis in enumerate("xyz", first):
            value, bound = robot.F_ext_W[i], robot.force_bound_W[i]
            share = abs(value) / bound if bound > 0.0 else 0.0
            style = "green" if share < 0.5 else "yellow" if share < 0.9 else "red"
            text.append(f"{axis} ").append(bar(share, encoding, SHORT_BAR), style=style)
            text.append(f" {value:+5.1f}/{bound:.0f}  ")
        shown.append((label, text.append(unit)))
    return shown


def panel(view: View, watch: Watch, encoding: str = "utf-8") -> RenderableType:
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="bold", no_wrap=True)
    grid.add_column()
    for label, text in rows(view, watch, encoding):
        grid.add_row(label, text)
    keys = Table.grid(padding=(0, 1))
    rows_of_keys = -(-len(view.help) // _KEY_COLUMNS)
    for i in range(rows_of_keys):
        row = view.help[i::rows_of_keys]
        keys.add_row(*(Text(text, style=style) for pair in row for text, style in _styled(*pair)))
    return Panel(Group(grid, Text(""), keys), title=view.title, title_align="left")


def _styled(key: str, does: str) -> tuple[tuple[str, str], tuple[str, str]]:
    return (key, "bold red" if does == "E-STOP" else "bold"), (does, "dim")


def line(view: View, watch: Watch) -> str:
    """The screen in one line, for an output that is no terminal."""
    return " | ".join(f"{label or 'note'}: {text.plain}" for label, text in rows(view, watch) if text.plain)
