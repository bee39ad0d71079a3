"""Every question of `log check` can be answered with no: each test spoils one thing in a sound log."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from handmade import altered, encoded, end
from tandem_lcm.tandem.control_tick_t import control_tick_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.policy_announce_t import policy_announce_t
from typer.testing import CliRunner

from tandem.cli.app import app
from tandem.log import EventLog
from tandem.log.check import KINDS, Report, check

Write = Callable[..., Path]


def found(log: Path) -> dict[str, int]:
    return {kind: n for kind, n in check(EventLog(log)).counts.items() if kind != "force"}


def test_sound_log_has_no_finding(real_log: Path) -> None:
    assert found(real_log) == {}


def _set(channel: str, where: dict[str, int], **values: Any) -> Callable[[str, Any], None]:
    """Sets fields of the messages of a channel whose fields are as in `where`."""

    def change(name: str, message: Any) -> None:
        if name == channel and all(getattr(message, key) == value for key, value in where.items()):
            for key, value in values.items():
                setattr(message, key, value)

    return change


def _without(channel: str, **where: int) -> Callable[[str, Any], bool]:
    def change(name: str, message: Any) -> bool:
        return not (name == channel and all(getattr(message, key) == value for key, value in where.items()))

    return change


def _step(**values: Any) -> Callable[[str, Any], None]:
    return _set("EPISODE_STEP", {"episode": 1, "step": 4}, **values)


def _state(**values: Any) -> Callable[[str, Any], None]:
    return _set("ROBOT_STATE", {"episode": 1, "tick": 400}, **values)


SPOILED = {
    "a step is missing": (_without("EPISODE_STEP", episode=1, step=4), {"steps", "returns"}),
    "a step was changed": (_step(force_peak=99.0), {"steps"}),
    "an episode is missing": (_without("EPISODE_END", episode=0), {"episodes"}),
    "env steps do not add up": (_set("EPISODE_END", {"episode": 1}, env_steps_total=7), {"episodes"}),
    "a return is wrong": (_step(discounted_return=0.9), {"returns", "steps"}),
    "a reward came early": (_step(reward=1.0), {"returns", "steps"}),
    "a step says that it was the last": (_step(terminated=1), {"returns", "steps"}),
    "an action is too large": (_step(policy_action=[1.5] * 7), {"actions", "steps"}),
    "an action is not finite": (_step(policy_action=[float("nan")] * 7), {"actions", "steps"}),
    "a masked axis moved": (
        _step(executed_action=[0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 1.0]),
        {"actions", "executed", "steps"},
    ),
    "nobody asked for it": (
        _step(executed_action=[-1.0, 1.0, 1.0, 0.0, 0.0, -1.0, 1.0]),
        {"executed", "steps"},
    ),
    "authority above 1": (_step(alpha=1.25), {"actions", "steps"}),
    "human action without intervention": (_step(intervention=0), {"intervention", "steps"}),
    "the operator had let go": (
        _set("TELEOP_COMMAND", {"episode_answered": 1, "tick_answered": 400}, engaged=0),
        {"intervention"},
    ),
    "an unknown policy acted": (
        lambda name, message: setattr(message, "policy_version", 9) if name == "EPISODE_STEP" else None,
        {"steps"},  # nothing was announced in this log: nothing to hold it against
    ),
    "a torque beyond its limit": (_state(tau_commanded=[88.0] + [0.0] * 6), {"torque"}),
    "a torque is not finite": (_state(tau_commanded=[float("nan")] * 7), {"torque"}),
    "a force is not finite": (_state(F_ext_W=[float("inf")] * 6), {"torque"}),
    "outside of the workspace": (_state(p_WE_reference=[0.9, 0.0, 0.2]), {"workspace"}),
    "a state is missing": (_without("ROBOT_STATE", episode=1, tick=400), {"gaps"}),
    "a world is missing": (_without("WORLD_STATE", episode=1, tick=400), {"gaps"}),
    "no scenario": (_without("SCENARIO"), {"scenario"}),
    "a fault is told and no error": (_set("EPISODE_END", {"episode": 1}, fault=6), {"faults"}),
}


@pytest.mark.parametrize("what", sorted(SPOILED))
def test_one_spoiled_thing_is_found_and_nothing_else(real_log: Path, tmp_path: Path, what: str) -> None:
    change, kinds = SPOILED[what]
    assert set(found(altered(real_log, tmp_path / "log.lcm", change))) == kinds


def test_place_of_a_finding_is_told(real_log: Path, tmp_path: Path) -> None:
    log = altered(real_log, tmp_path / "log.lcm", _step(discounted_return=0.9))
    finding = next(f for f in check(EventLog(log)).findings if f.kind == "returns")
    assert (finding.episode, finding.tick) == (1, 400)
    assert str(finding).startswith(
        "returns: episode 1, tick 400: the return is 0.9; from the rewards and discount 0.95"
    )


def test_damage_is_told_with_its_episode_and_a_cut_tail_is_a_note(real_log: Path, write: Write) -> None:
    data = bytearray(real_log.read_bytes())
    log = EventLog(real_log)
    state = log.index.rows("ROBOT_STATE")[-5]
    offset = int(log.index.offset[state])
    data[offset : offset + 4] = b"\0\0\0\0"
    report = check(EventLog(write(bytes(data[:-10]))))
    assert report.counts["damage"] == 1 and report.counts["cut_off"] == 1
    assert report.counts["gaps"] == 1  # of the state that is gone
    cut_only = check(EventLog(write(real_log.read_bytes() + data[offset : offset + 3])))
    assert cut_only.counts["damage"] + cut_only.counts["cut_off"] == 1


def tick(number: int, missed: int = 0, jump: float = 0.0) -> control_tick_t:
    message = control_tick_t()
    message.tick, message.missed_cycles = number, missed
    message.tau_commanded = [jump] + [0.0] * 6
    return message


def test_real_time_ticks_are_asked_for_overruns_gaps_and_torque_rates(write: Write) -> None:
    sound = [tick(n) for n in range(50)]
    kinds = {"scenario"}  # a log by hand has none
    assert set(found(write(*encoded(*sound, end(0))))) - {"steps"} == kinds
    late = found(write(*encoded(*sound[:20], tick(20, missed=3), *sound[21:])))
    assert late["overruns"] == 1
    lost = found(write(*encoded(*sound[:20], *sound[25:])))
    assert lost["gaps"] == 1
    rough = found(write(*encoded(*sound[:20], tick(20, jump=1.5), *sound[21:])))
    assert rough["torque"] == 1
    dropped = controller_status_t()
    dropped.records_dropped = 4
    assert found(write(*encoded(*sound, dropped)))["overruns"] == 1


def test_policy_that_was_not_announced_and_file_that_is_another_are_found(
    real_log: Path, tmp_path: Path
) -> None:
    announce = policy_announce_t()
    announce.version, announce.path, announce.n_bytes, announce.sha256 = 1, "policy.safetensors", 3, "0" * 64
    (tmp_path / "policy.safetensors").write_bytes(b"abc")
    log = altered(
        real_log,
        tmp_path / "log.lcm",
        lambda name, m: setattr(m, "policy_version", 9) if name == "EPISODE_STEP" else None,
    )
    log.write_bytes(log.read_bytes() + encoded(announce)[0])
    report = check(EventLog(log))
    assert report.counts["policies"] == 3  # each episode's first step, and the file
    assert "is not the file that was announced" in report.findings[-1].sentence


def test_many_findings_of_a_kind_are_all_counted_and_few_are_kept() -> None:
    report = Report()
    for n in range(100):
        report.add("gaps", "x", n)
    assert report.counts["gaps"] == 100 and len(report.findings) == 20 and report.errors == 100


def test_command_fails_for_errors_unless_they_are_ignored(real_log: Path, tmp_path: Path) -> None:
    log = altered(real_log, tmp_path / "log.lcm", _without("ROBOT_STATE", episode=1, tick=400))
    figures = tmp_path / "check.json"
    result = CliRunner().invoke(app, ["log", "check", str(log), "--json", str(figures)])
    assert result.exit_code == 1 and "error   gaps: episode 1, tick 410" in result.output
    assert json.loads(figures.read_text())["counts"]["gaps"] == 1
    assert CliRunner().invoke(app, ["log", "check", str(log), "--ignore", "gaps"]).exit_code == 0
    assert CliRunner().invoke(app, ["log", "check", str(real_log)]).exit_code == 0
    unknown = CliRunner().invoke(app, ["log", "check", str(log), "--ignore", "gasp"])
    assert unknown.exit_code == 2 and all(kind in unknown.output for kind in KINDS)
