"""`tandem log` as it is typed: what is printed, written and refused."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import lcm
import numpy as np
import pytest
from handmade import encoded, end, event_bytes, state
from typer.testing import CliRunner, Result

from tandem.cli.app import app
from tandem.log import EventLog, episodes, raw_events
from tandem.log.compare import first_difference
from tandem.run_folder import ROOT, program


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(app, ["log", *map(str, arguments)])
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    return result


def test_info_tells_episodes_rates_and_health(real_log: Path, tmp_path: Path) -> None:
    figures = tmp_path / "info.json"
    output = run("info", real_log, "--json", figures).output
    assert "demonstrations  2 episodes" in output and "2 success" in output and "nothing found" in output
    value = json.loads(figures.read_text())
    state_rate = value["channels"]["ROBOT_STATE"]
    assert state_rate["hz"] == pytest.approx(100.0) and state_rate["gaps"] == 0
    assert value["health"]["undecodable"] == 0 and value["episodes"] == 2
    cut = tmp_path / "log.lcm"
    cut.write_bytes(real_log.read_bytes()[:-40])
    assert "are an event cut off by a kill" in run("info", tmp_path).output


def test_stats_finds_a_gap_and_the_jitter(write, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    scenario = (ROOT / "config" / "run.yaml").read_text()
    yaml = (
        "run:\n" + "".join(f"  {line}\n" for line in scenario.splitlines()) + "task: {policy_rate_hz: 10}\n"
    )
    from tandem_lcm.tandem.scenario_t import scenario_t

    start = scenario_t()
    start.scenario_yaml = yaml
    ticks = [*range(0, 500, 10), *range(600, 1000, 10)]  # 100 Hz; nothing from 500 to 590
    states = [state(tick) for tick in ticks]
    states[3].utime += 2000  # 2 ms late: two intervals are off
    figures = tmp_path / "stats.json"
    run("stats", write(*encoded(start, *states, end(0))), "--json", figures)
    rate = json.loads(figures.read_text())["channels"]["ROBOT_STATE"]
    assert (rate["expected_hz"], rate["gaps"], rate["missing"]) == (100.0, 1, 10)
    assert rate["longest_gap_ms"] == pytest.approx(110.0)
    assert rate["jitter_ms"]["p50"] == 0.0 and rate["jitter_ms"]["max"] == pytest.approx(100.0)
    assert rate["hz"] == pytest.approx(1e3 * 89 / 990)


def test_between_episodes_is_no_gap(write, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    later = [state(tick) for tick in range(0, 100, 10)]
    for message in later:
        message.utime += 60_000_000
    figures = tmp_path / "stats.json"
    run(
        "stats",
        write(*encoded(*(state(t) for t in range(0, 100, 10)), end(0), *later, end(1))),
        "--json",
        figures,
    )
    assert json.loads(figures.read_text())["channels"]["ROBOT_STATE"]["hz"] == pytest.approx(100.0)


def test_echo_prints_fields_of_an_episode_as_json_lines(real_log: Path) -> None:
    lines = run(
        "echo", real_log, "ROBOT_STATE", "tick", "q_measured[3]", "--episodes", "1", "--every", 2, "--json"
    ).output.splitlines()
    shown = [json.loads(line) for line in lines]
    assert [line["tick"] for line in shown[:3]] == [0, 20, 40]
    states = EventLog(real_log).columns("ROBOT_STATE", "episode", "q_measured")
    expected = states["q_measured"][states["episode"] == 1][::2, 3]
    assert [line["q_measured[3]"] for line in shown] == expected.tolist()
    assert set(shown[0]) == {"time_s", "tick", "q_measured[3]"}


def test_echo_makes_null_of_what_is_not_finite(write) -> None:  # type: ignore[no-untyped-def]
    message = state(0)
    message.alpha = float("nan")
    line = run("echo", write(*encoded(message)), "ROBOT_STATE", "alpha", "--json").output
    assert json.loads(line) == {"time_s": 0.0, "alpha": None}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["ROBOT_STAT"], "has no channel ROBOT_STAT; it has SCENARIO"),
        (["ROBOT_STATE", "q_measurd"], "has no field q_measurd; did you mean q_measured?"),
        (["ROBOT_STATE", "q_measured[9]"], "has 7 elements; [9] is not among them"),
        (["ROBOT_STATE", "q_measured["], "'q_measured[' is no field"),
        (["ROBOT_STATE", "--episodes", "7"], "holds no episode in 7; it has episodes 0 to 1"),
        (["ROBOT_STATE", "--episodes", "x"], "--episodes is 'x'; it must be like"),
        (["ROBOT_STATE", "--from", "1000"], "has nothing from 1000"),
    ],
)
def test_echo_refuses_with_a_sentence(real_log: Path, arguments: list[str], sentence: str) -> None:
    assert sentence in run("echo", real_log, *arguments, code=2).output


def test_cut_episode_is_a_log_that_replays_bit_for_bit(real_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "cut.lcm"
    run("cut", real_log, out, "--episodes", "1")
    assert [episode.number for episode in episodes(out)] == [1]
    assert next(iter(lcm.EventLog(str(out), "r"))).channel == "SCENARIO"
    assert [event.eventnum for event in lcm.EventLog(str(out), "r")] == list(range(len(EventLog(out).index)))
    replayed = subprocess.run(
        [program("tandem_replay"), out, "--root", ROOT], capture_output=True, text=True, check=True
    )
    assert "1 episodes" in replayed.stdout and " 0 differences" in replayed.stdout


def test_cut_by_time_takes_what_lies_in_it(real_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "cut.lcm"
    run("cut", real_log, out, "--from", 0.5, "--to", 1.0)
    ticks = EventLog(out).columns("ROBOT_STATE", "tick")["tick"]
    np.testing.assert_array_equal(ticks, np.arange(500, 1000, 10))
    assert "cut needs to know what" in run("cut", real_log, out, code=2).output
    assert "is the log that is read" in run("cut", out, out, "--from", 0, code=2).output


def test_merged_parts_are_the_log_again(real_log: Path, tmp_path: Path) -> None:
    for part in ("0", "1"):
        run("cut", real_log, tmp_path / f"{part}.lcm", "--episodes", part)
    run("merge", tmp_path / "all.lcm", tmp_path / "0.lcm", tmp_path / "1.lcm")
    channels = "ROBOT_STATE|WORLD_STATE|EPISODE_.*|TELEOP_COMMAND"
    count, difference = first_difference(real_log, tmp_path / "all.lcm", channels)
    assert difference is None and count > 100


def test_merge_goes_by_time_and_keeps_the_order_within_a_log(write, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    a = write(*(event_bytes(0, t, "A", bytes([n])) for n, t in enumerate([10, 30, 20, 40])), name="a")
    b = write(*(event_bytes(0, t, "B", bytes([n])) for n, t in enumerate([5, 30, 35])), name="b")
    run("merge", tmp_path / "m", a, b)
    assert [(e.channel, e.data[0]) for e in raw_events(tmp_path / "m")] == [
        *[("B", 0), ("A", 0), ("A", 1), ("A", 2), ("B", 1), ("B", 2), ("A", 3)]
    ]
    assert "needs two logs or more" in run("merge", tmp_path / "m", a, code=2).output


def test_episode_and_run_are_drawn(real_log: Path, tmp_path: Path) -> None:
    run("plot", real_log, "--episode", 1, "--out", tmp_path / "e.png")
    run("plot", real_log, "--out", tmp_path / "r.png")
    for name in ("e.png", "r.png"):
        assert (tmp_path / name).read_bytes()[:4] == b"\x89PNG" and (tmp_path / name).stat().st_size > 20_000
    assert "holds no episode 9; it has 0 to 1" in run("plot", real_log, "--episode", 9, code=2).output
    assert "must end in .png" in run("plot", real_log, "--out", tmp_path / "x.gif", code=2).output


def test_video_asks_for_what_there_is(real_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.mp4"
    assert "holds no episode in 5" in run("video", real_log, "--episodes", 5, "--out", out, code=2).output
    assert "must end in .mp4" in run("video", real_log, "--episodes", 1, "--out", "x.png", code=2).output


@pytest.mark.parametrize("command", ["info", "stats", "check", "plot"])
def test_no_log_is_a_sentence(command: str, tmp_path: Path) -> None:
    assert "does not exist; give an event log or a run folder" in run(command, tmp_path, code=2).output
    empty = tmp_path / "log.lcm"
    empty.write_bytes(b"")
    run(command, empty, code={"check": 1, "plot": 1}.get(command, 0))
