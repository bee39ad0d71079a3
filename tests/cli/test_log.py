"""log compare and log info."""

from pathlib import Path
from typing import Any

import lcm
import pytest
from tandem_lcm.tandem.action_chunk_t import action_chunk_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from typer.testing import CliRunner

from tandem.cli.app import app
from tandem.log import EventLog
from tandem.log.compare import first_difference
from tandem.log.facts import describe


def chunk(wall_us: int, x: float = 0.5, chunk_id: int = 0) -> tuple[str, Any]:
    message = action_chunk_t()
    message.episode, message.chunk_id, message.horizon = 4, chunk_id, 2
    message.policy_chunk = [[x] * 7, [0.0] * 7]
    message.wall_inference_us = wall_us
    return "ACTION_CHUNK", message


def end(outcome: int, human: int = 0) -> tuple[str, Any]:
    message = episode_end_t()
    message.outcome, message.phase, message.n_steps, message.n_intervention_steps = outcome, 1, 10, human
    return "EPISODE_END", message


def write(path: Path, *events: tuple[str, Any], start: int = 0) -> Path:
    log = lcm.EventLog(str(path), "w", overwrite=True)
    for i, (channel, message) in enumerate(events):
        log.write_event(start + i, channel, message.encode())
    log.close()
    return path


def test_wall_fields_and_write_times_are_left_out(tmp_path: Path) -> None:
    a = write(tmp_path / "a", chunk(10), end(0), start=100)
    b = write(tmp_path / "b", chunk(99), end(0), start=900)
    assert first_difference(a, b) == (2, None)


def test_first_differing_field_is_named_with_its_place(tmp_path: Path) -> None:
    a = write(tmp_path / "a", chunk(1), chunk(1, x=0.5, chunk_id=1))
    b = write(tmp_path / "b", chunk(2), chunk(2, x=-0.5, chunk_id=1))
    count, clause = first_difference(a, b)
    assert count == 1
    assert clause == "ACTION_CHUNK (event 1, episode 4, chunk_id 1): policy_chunk[0][0] is 0.5 and -0.5"


def test_negative_zero_is_not_zero(tmp_path: Path) -> None:
    a, b = write(tmp_path / "a", chunk(1, x=0.0)), write(tmp_path / "b", chunk(1, x=-0.0))
    assert first_difference(a, b)[1] is not None


def test_missing_and_exchanged_events_differ(tmp_path: Path) -> None:
    a, b = write(tmp_path / "a", chunk(1), end(0)), write(tmp_path / "b", chunk(1))
    clause = first_difference(a, b)[1]
    assert clause is not None and "has more events, from EPISODE_END" in clause
    c = write(tmp_path / "c", end(0), chunk(1))
    clause = first_difference(a, c)[1]
    assert clause is not None and clause.startswith("event 0 is ACTION_CHUNK")
    assert first_difference(a, b, "ACTION_.*") == (1, None)


def test_compare_exits_with_1_when_different(tmp_path: Path) -> None:
    a, b = write(tmp_path / "a", end(0)), write(tmp_path / "b", end(1))
    result = CliRunner().invoke(app, ["log", "compare", str(a), str(b)])
    assert result.exit_code == 1
    assert "outcome is 0 and 1" in result.output
    assert CliRunner().invoke(app, ["log", "compare", str(a), str(a)]).exit_code == 0


def test_info_counts_outcomes_and_human_share(tmp_path: Path) -> None:
    one, other = end(0, human=3), end(1, human=1)
    other[1].episode = 1
    value = describe(EventLog(write(tmp_path / "log.lcm", one, other)))
    assert value["phases"]["training"]["outcomes"] == {"success": 1, "timeout": 1}
    assert value["phases"]["training"]["human_share"] == pytest.approx(0.2)
    assert value["cut_off_bytes"] == 0
