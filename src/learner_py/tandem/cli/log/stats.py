"""`tandem log stats`."""

from dataclasses import asdict

from tandem.cli.common import JsonOption, sentences, write_json
from tandem.cli.log.common import LogArgument, opened


def stats(log: LogArgument, json_file: JsonOption = None) -> None:
    """How regularly each channel came: rate, expected rate, jitter, gaps, bandwidth, undecodable messages.

    Within episodes, by the times in the messages (simulated time in lockstep). Jitter: how far intervals are from the
    expected period, else from their median. A gap: more than 1.5 expected periods. JSON: channels by name.
    """
    from tandem.log.rates import rates, robot_time_s

    with sentences():
        event_log = opened(log)
        value, seconds = rates(event_log), robot_time_s(event_log)
    print(f"{event_log.path}: {seconds:.1f} s of robot time in {len(event_log.episodes)} episodes")
    print(
        f"{'channel':<20} {'events':>9} {'Hz':>8} {'expected':>8} {'jitter p50':>10} {'p99 ms':>8}"
        f" {'gaps':>6} {'missing':>8} {'longest ms':>10} {'kB/s':>8} {'undecodable':>11}"
    )

    def shown(number: float | None, digits: int = 1) -> str:
        return "-" if number is None else f"{number:.{digits}f}"

    for name, rate in value.items():
        jitter: dict[str, float | None] = {"p50": None, "p99": None, **(rate.jitter_ms or {})}
        speed = None if rate.bytes_per_s is None else rate.bytes_per_s / 1e3
        print(
            f"{name:<20} {rate.events:>9} {shown(rate.hz):>8} {shown(rate.expected_hz):>8}"
            f" {shown(jitter['p50'], 3):>10} {shown(jitter['p99'], 3):>8} {shown(rate.gaps, 0):>6}"
            f" {shown(rate.missing, 0):>8} {shown(rate.longest_gap_ms):>10} {shown(speed):>8}"
            f" {rate.undecodable:>11}"
        )
    write_json(
        json_file,
        {
            "file": str(event_log.path),
            "robot_time_s": seconds,
            "channels": {name: asdict(rate) for name, rate in value.items()},
        },
    )
