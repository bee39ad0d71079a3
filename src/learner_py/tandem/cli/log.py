"""`tandem log info|compare`: event logs of runs (standard LCM logs)."""

from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, fail, sentences, write_json

app = typer.Typer(help="Look into event logs (RUN/log.lcm).", no_args_is_help=True)

LogArgument = Annotated[Path, typer.Argument(help="Event log, or a run folder.")]


@app.command("info")
def info(log: LogArgument, json_file: JsonOption = None) -> None:
    """What a log holds: scenario, episodes by phase and outcome, human share, channels."""
    with sentences():
        value = describe(find(log))
    print(f"{value['file']}: {value['bytes'] / 1e6:.1f} MB, {value['events']} events")
    if cut := value["cut_off_bytes"]:
        print(f"  the last {cut} bytes are an event cut off by a kill; readers leave it out")
    if scenario := value["scenario"]:
        print(
            f"  scenario  {scenario['task']}, {scenario['method']}, seed {scenario['seed']},"
            f" mode {scenario['mode']};"
            f" program {scenario['git_revision']}"
        )
    if value["resumed_at"]:
        print("  resumed   at episode " + ", ".join(str(n) for n in value["resumed_at"]))
    for phase, part in value["phases"].items():
        outcomes = ", ".join(f"{n} {name}" for name, n in part["outcomes"].items())
        print(
            f"  {phase:<15} {part['episodes']} episodes, {part['steps']} steps: {outcomes};"
            f" human {100 * part['human_share']:.1f} %"
        )
    print(f"  {'channel':<20} {'events':>9} {'MB':>9}")
    for channel, part in value["channels"].items():
        print(f"  {channel:<20} {part['events']:>9} {part['bytes'] / 1e6:>9.2f}")
    write_json(json_file, value)


@app.command("compare")
def compare(
    a: LogArgument,
    b: LogArgument,
    channel: Annotated[
        str, typer.Option(help="Only channels that match this regular expression, whole.")
    ] = ".*",
    json_file: JsonOption = None,
) -> None:
    """Compare two logs event by event, bit for bit; exit code 1 and the first difference when not equal.

    Left out: the times at which events were written, and fields named wall_*, which are measured on the
    machine's clock.
    """
    with sentences():
        events, difference = first_difference(find(a), find(b), channel)
    write_json(
        json_file,
        {"a": str(a), "b": str(b), "equal": difference is None, "events": events, "difference": difference},
    )
    if difference:
        print(f"different: {difference}")
        raise typer.Exit(1)
    print(f"equal: {events} events")


def find(log: Path) -> Path:
    """An event log from a file or a run folder."""
    from tandem.run_folder import RunFolder

    log = RunFolder(log).log if log.is_dir() else log
    if not log.is_file():
        fail(f"{log} does not exist; give an event log or a run folder.", 2)
    return log


def mask_wall(message: Any) -> Any:
    """The message with every wall_* field zeroed."""
    for name in message.__slots__:
        if name.startswith("wall_"):
            setattr(message, name, _zero(getattr(message, name)))
    return message


def _zero(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_zero(item) for item in value]
    return type(value)()


def first_difference(a: Path, b: Path, channel: str = ".*") -> tuple[int, str | None]:
    """(events compared, a clause about the first difference or None)."""
    import itertools
    import re

    from tandem.run_folder import raw_events

    wanted = re.compile(channel)

    def matching(path: Path) -> Any:
        return (event for event in raw_events(path) if wanted.fullmatch(event.channel))

    count = 0
    for left, right in itertools.zip_longest(matching(a), matching(b)):
        if left is None or right is None:
            longer, event = (b, right) if left is None else (a, left)
            return count, f"{longer} has more events, from {_place(event)} on"
        if left.channel != right.channel:
            return count, f"event {count} is {_place(left)} in {a} and {_place(right)} in {b}"
        if left.data != right.data and (clause := _message_difference(left, right)):
            return count, clause
        count += 1
    return count, None


def _place(event: Any) -> str:
    from tandem.wire import decode

    message = decode(event.channel, event.data)
    parts = [
        f"{name} {getattr(message, name)}"
        for name in ("episode", "tick", "step", "chunk_id", "version")
        if hasattr(message, name)
    ]
    return f"{event.channel} (event {event.number}{''.join(', ' + part for part in parts)})"


def _message_difference(left: Any, right: Any) -> str | None:
    from tandem.wire import decode

    one, two = decode(left.channel, left.data), decode(right.channel, right.data)
    if one is None or two is None:
        return f"{_place(left)}: the bytes differ"
    if mask_wall(one).encode() == mask_wall(two).encode():
        return None
    for name in one.__slots__:
        # repr, since NaN equals itself here and -0 differs from 0
        if repr(getattr(one, name)) != repr(getattr(two, name)):
            place, x, y = _innermost(name, getattr(one, name), getattr(two, name))
            return f"{_place(left)}: {place} is {_short(x)} and {_short(y)}"
    return f"{_place(left)}: the bytes differ"


def _innermost(name: str, x: Any, y: Any) -> tuple[str, Any, Any]:
    """The first differing element of two arrays of one shape, by name and index."""
    if isinstance(x, list | tuple) and len(x) == len(y):
        for i, (left, right) in enumerate(zip(x, y, strict=True)):
            if repr(left) != repr(right):
                return _innermost(f"{name}[{i}]", left, right)
    return name, x, y


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 200 else text[:200] + " ..."


def describe(log: Path) -> dict[str, Any]:
    """The figures of `log info`."""
    import yaml

    from tandem.live_view import OUTCOMES, PHASES
    from tandem.run_folder import raw_events
    from tandem.statistics import share
    from tandem.summary import read_episodes
    from tandem.wire import decode

    channels: dict[str, dict[str, int]] = {}
    scenario: dict[str, Any] | None = None
    resumed_at: list[int] = []
    read = 0
    for event in raw_events(log):
        part = channels.setdefault(event.channel, {"events": 0, "bytes": 0})
        part["events"] += 1
        part["bytes"] += len(event.data)
        read += 28 + len(event.channel) + len(event.data)
        if event.channel == "SCENARIO" and (message := decode(event.channel, event.data)):
            run = (yaml.safe_load(message.scenario_yaml) or {}).get("run", {})
            scenario = {key: run.get(key) for key in ("task", "method", "seed", "mode", "clock")}
            scenario["git_revision"] = message.git_revision
            if message.first_episode:
                resumed_at.append(message.first_episode)
    phases: dict[str, dict[str, Any]] = {}
    for phase, name in PHASES.items():
        ends = [end for end in read_episodes(log) if end.phase == phase]
        if not ends:
            continue
        steps = sum(end.n_steps for end in ends)
        phases[name] = {
            "episodes": len(ends),
            "steps": steps,
            "outcomes": dict(Counter(OUTCOMES.get(end.outcome, "?") for end in ends)),
            "human_share": share(sum(end.n_intervention_steps for end in ends), steps),
            "takeovers": sum(end.n_takeovers for end in ends),
            "force_peak_max": max(end.force_peak for end in ends),
        }
    size = log.stat().st_size
    return {
        "file": str(log),
        "bytes": size,
        "events": sum(part["events"] for part in channels.values()),
        "cut_off_bytes": size - read,
        "scenario": scenario,
        "resumed_at": resumed_at,
        "phases": phases,
        "channels": dict(sorted(channels.items())),
    }
