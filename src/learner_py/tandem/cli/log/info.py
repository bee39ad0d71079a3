"""`tandem log info`."""

from typing import Any

from tandem.cli.common import JsonOption, sentences, write_json
from tandem.cli.log.common import LogArgument, opened


def info(log: LogArgument, json_file: JsonOption = None) -> None:
    """What a log holds: scenario, episodes by phase and outcome, human share, policies, channels, health."""
    from tandem.log.facts import describe

    with sentences():
        value = describe(opened(log))
    for line in _lines(value):
        print(line)
    write_json(json_file, value)


def _lines(value: dict[str, Any]) -> list[str]:
    files = f" and {value['files'] - 1} files more" if value["files"] > 1 else ""
    lines = [
        f"{value['file']}{files}: {value['bytes'] / 1e6:.1f} MB, {value['events']} events,"
        f" {value['robot_time_s']:.0f} s of robot time"
    ]
    if scenario := value["scenario"]:
        lines.append(
            f"  scenario  {scenario['task']}, {scenario['method']}, seed {scenario['seed']},"
            f" mode {scenario['mode']}, {scenario['clock']}; program {scenario['git_revision']}"
        )
    if value["resumed_at"]:
        lines.append("  resumed   at episode " + ", ".join(str(n) for n in value["resumed_at"]))
    if policies := value["policies"]:
        lines.append(
            f"  policies  {policies['versions']} versions in force, {policies['first']} to {policies['last']};"
            f" the last after {policies['last_updates']} updates, trained through episode"
            f" {policies['last_trained_through']}"
        )
    for phase, part in value["phases"].items():
        outcomes = ", ".join(f"{n} {name}" for name, n in part["outcomes"].items())
        lines.append(
            f"  {phase:<15} {part['episodes']} episodes, {part['steps']} steps: {outcomes};"
            f" human {100 * part['human_share']:.1f} %, {part['takeovers']} take-overs,"
            f" peak force {part['force_peak_max']:.0f} N"
        )
    lines.append(f"  {'channel':<20} {'events':>9} {'MB':>9} {'Hz':>8} {'gaps':>6}")
    for channel, rate in value["channels"].items():
        hz = "-" if rate["hz"] is None else f"{rate['hz']:.1f}"
        gaps = "-" if rate["gaps"] is None else rate["gaps"]
        lines.append(f"  {channel:<20} {rate['events']:>9} {rate['bytes'] / 1e6:>9.2f} {hz:>8} {gaps:>6}")
    return [*lines, *_health(value)]


def _health(value: dict[str, Any]) -> list[str]:
    health = value["health"]
    said = []
    if cut := value["cut_off_bytes"]:
        said.append(f"the last {cut} bytes are an event cut off by a kill; readers leave it out")
    if names := health["files_missing"]:
        said.append(f"{', '.join(names)} of its files are missing; what follows them is there")
    if n := health["damaged_regions"]:
        said.append(f"{health['damaged_bytes']} bytes in {n} places are damaged and skipped")
    if n := health["undecodable"]:
        said.append(f"{n} events do not decode as the type of their channel (another version of Tandem?)")
    if n := health["episodes_missing"]:
        said.append(f"{n} episodes are missing between others")
    if n := health["episodes_without_motion"]:
        said.append(
            f"{n} episodes have no motion, only what is learnt from: beyond run.log_quota_mb, or brought in from"
            " elsewhere"
        )
    if n := health["records_dropped"]:
        said.append(f"{n} tick records were lost because the recorder was too slow")
    if n := health["overruns"]:
        said.append(f"{n} ticks missed their deadline")
    said += [f"{n} episodes ended because of: {fault}" for fault, n in health["faults"].items()]
    return [
        f"  health    {sentence}" for sentence in said or ["nothing found; ./tandem log check reads it all"]
    ]
