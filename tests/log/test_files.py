"""A log in several files is the log that one file would be, for everything that reads logs; the quota."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import lcm
import numpy as np
import pytest
from handmade import encoded, end, state
from typer.testing import CliRunner, Result

from tandem import processes, run_folder, scenario
from tandem.cli.app import app
from tandem.log import EventLog, episodes
from tandem.log.files import files_of
from tandem.log.index import index_file
from tandem.spy.recording import RecordedSource, Recording


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(app, list(map(str, arguments)))
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    return result


def demonstrated(folder: Path, **values: Any) -> Path:
    """The log of demonstrations with ROBOT_STATE of every tick: more than a megabyte each."""
    composed = scenario.compose(run_folder.CONFIG, "peg", "tandem", {}).copy_with(
        mode="demonstrate", clock="lockstep", seed=5_000_000, robot_state_hz=1000, **values
    )
    folder.mkdir(exist_ok=True)
    composed.write(folder / "scenario.yaml")
    common = ["--scenario", folder / "scenario.yaml", "--lcm-url", processes.free_lcm_url()]
    programs = [
        processes.Child(
            "operator", [run_folder.program("tandem_operator"), *common], folder / "operator.out"
        ),
        processes.Child(
            "controller",
            [run_folder.program("tandem_controller"), *common, "--run", folder],
            folder / "controller.out",
        ),
    ]
    try:
        assert programs[1].wait(60.0) == 0, (folder / "controller.out").read_text()
    finally:
        for program in programs:
            program.stop(5.0)
    return folder / "log.lcm"


@pytest.fixture(scope="session")
def in_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four demonstrations, the fourth in a run that went on."""
    folder = tmp_path_factory.mktemp("files") / "run"
    demonstrated(folder, episodes=3, log_file_mb=1)
    return demonstrated(folder, episodes=4, log_file_mb=1)


@pytest.fixture(scope="session")
def in_one(in_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same bytes in one file."""
    log = tmp_path_factory.mktemp("one") / "log.lcm"
    log.write_bytes(b"".join(file.read_bytes() for file in files_of(in_files)))
    return log


@pytest.fixture(scope="session")
def beyond_quota(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return demonstrated(tmp_path_factory.mktemp("quota") / "run", episodes=3, log_quota_mb=2)


def test_each_file_is_a_log_of_whole_episodes(in_files: Path) -> None:
    files = files_of(in_files)
    assert [file.name for file in files] == ["log.lcm", "log.lcm.01", "log.lcm.02", "log.lcm.03"]
    for number, file in enumerate(files):
        channels = [event.channel for event in lcm.EventLog(str(file), "r")]
        assert channels.count("EPISODE_END") == 1
        alone = EventLog(file) if number else None
        assert alone is None or alone.episodes.number.tolist() == [number]


def test_every_event_and_column_is_that_of_one_file(in_files: Path, in_one: Path) -> None:
    several, one = EventLog(in_files), EventLog(in_one)
    assert list(several.events()) == list(one.events())
    assert len(several.index) > 4000 and several.index.n_bytes == one.index.n_bytes
    names = ("tick", "F_ext_W", "q_measured")
    columns = several.columns("ROBOT_STATE", *names)
    for name, column in one.columns("ROBOT_STATE", *names).items():
        np.testing.assert_array_equal(columns[name], column)
    assert several.episodes.number.tolist() == [0, 1, 2, 3]
    assert [e.end.steps_sha256 for e in episodes(in_files)] == [e.end.steps_sha256 for e in episodes(in_one)]


def test_commands_take_the_files_as_one_log(in_files: Path, in_one: Path, tmp_path: Path) -> None:
    told = []
    for log in (in_files.parent, in_one):
        run("log", "info", log, "--json", tmp_path / "info.json")
        told.append(json.loads((tmp_path / "info.json").read_text()))
    assert told[0] == {**told[1], "file": str(in_files), "files": 4}
    assert "and 3 files more" in run("log", "info", in_files).output
    assert "no error" in run("log", "check", in_files).output
    assert "equal" in run("log", "compare", in_files, in_one).output
    run("log", "cut", in_files, tmp_path / "cut.lcm", "--episodes", "1-2")
    assert EventLog(tmp_path / "cut.lcm").episodes.number.tolist() == [1, 2]
    run("log", "merge", tmp_path / "all.lcm", in_files, tmp_path / "cut.lcm", "--by", "utime")
    assert len(EventLog(tmp_path / "all.lcm").index) > len(EventLog(in_files).index)
    run("log", "plot", in_files, "--episode", "3", "--out", tmp_path / "page.png")
    for log, out in ((in_files, "several.csv"), (in_one, "one.csv")):
        run("export", "csv", log, "--out", tmp_path / out)
    assert (tmp_path / "several.csv").read_bytes() == (tmp_path / "one.csv").read_bytes()


def test_replay_goes_through_all_files(in_files: Path, tmp_path: Path) -> None:
    run("replay", in_files, "--json", tmp_path / "replay.json")
    result = json.loads((tmp_path / "replay.json").read_text())
    assert (result["episodes"], result["differences"]) == (4, 0) and result["torques_one_by_one"] > 10_000


def test_spy_plays_and_seeks_through_all_files(in_files: Path, in_one: Path) -> None:
    several, one = Recording(in_files), Recording(in_one)
    assert (several.begin_us, several.end_us) == (one.begin_us, one.end_us)
    for share in (0.9, 0.1, 0.6, 0.0):
        to = int(one.begin_us + share * (one.end_us - one.begin_us))
        several.go_to(to)
        one.go_to(to)
        left = [list(iter(recording.take, None)) for recording in (several, one)]
        assert left[0] == left[1] and len(left[0]) > 100
    several.close()
    one.close()


def test_spy_goes_on_into_a_file_that_is_begun_meanwhile(in_files: Path, tmp_path: Path) -> None:
    files = files_of(in_files)
    (tmp_path / "log.lcm").write_bytes(files[0].read_bytes())
    source = RecordedSource(tmp_path / "log.lcm", None)
    while not source.ended:
        source._polled = time.monotonic() - 10.0
        source.poll()
    (tmp_path / "log.lcm.01").write_bytes(files[1].read_bytes())
    assert not source.ended
    source._polled = time.monotonic() - 10.0
    assert "ROBOT_STATE" in source.poll().channels
    source.close()


def test_index_lies_beside_each_file_and_only_the_last_is_read_again(
    in_files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tandem.log import index

    for file in files_of(in_files)[:3]:
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.setattr(index, "KEPT_FROM_BYTES", 2 << 20)  # of the log, whatever each file has
    log = tmp_path / "log.lcm"
    EventLog(log, keep_index=True)
    assert all(index_file(file).is_file() for file in files_of(log))
    scanned: list[str] = []
    extend = index._extend
    monkeypatch.setattr(
        index, "_extend", lambda file, *rest: scanned.append(file.name) or extend(file, *rest)
    )
    (tmp_path / "log.lcm.03").write_bytes(files_of(in_files)[3].read_bytes())
    again = EventLog(log, keep_index=True)
    assert scanned == ["log.lcm.03"]
    assert list(again.events()) == list(EventLog(in_files).events())


def test_cut_off_tail_counts_only_in_the_last_file(write) -> None:  # type: ignore[no-untyped-def]
    first, second = encoded(state(0), state(10), end(0)), encoded(state(0, 1), end(1))
    log = write(*first)
    write(*second, second[0][:50], name="log.lcm.01")
    index = EventLog(log).index
    assert (index.cut_off_bytes, index.damage, len(index)) == (50, [], 5)
    write(*first, first[0][:50])
    opened = EventLog(log)
    begin = sum(map(len, first))
    assert (opened.index.cut_off_bytes, opened.index.damage) == (50, [(begin, begin + 50)])
    assert [event.message.episode for event in opened.messages("EPISODE_END")] == [0, 1]


def test_missing_file_is_told_and_the_others_are_read(write) -> None:  # type: ignore[no-untyped-def]
    log = write(*encoded(state(0), end(0)))
    write(*encoded(state(0, 2), end(2)), name="log.lcm.02")
    write(b"of somebody else", name="log.lcm.index.old")
    write(b"of somebody else", name="log.lcm.3")
    assert EventLog(log).episodes.number.tolist() == [0, 2]
    assert "log.lcm.01 of its files are missing" in run("log", "info", log).output
    assert "log.lcm.01 is missing" in run("log", "check", log, code=1).output


def test_log_is_not_written_where_old_files_would_follow_it(real_log: Path, tmp_path: Path) -> None:
    (tmp_path / "new.lcm.01").write_bytes(real_log.read_bytes())
    output = run("log", "cut", real_log, tmp_path / "new.lcm", "--episodes", "0", code=1).output
    assert "would be read as what follows" in output and not (tmp_path / "new.lcm").exists()


def test_beyond_the_quota_everything_that_is_learnt_from_is_there(beyond_quota: Path, tmp_path: Path) -> None:
    log = EventLog(beyond_quota)
    assert [e.number for e in episodes(beyond_quota)] == [0, 1, 2]  # whole, by their digests
    shown = set(log.columns("ROBOT_STATE", "episode")["episode"].tolist())
    assert 0 in shown and 2 not in shown
    assert set(log.columns("WORLD_STATE", "episode")["episode"].tolist()) == shown
    without = 3 - len(shown)
    assert "run.log_quota_mb" in (beyond_quota.parent / "controller.out").read_text()
    assert f"{without} episodes have no motion" in run("log", "info", beyond_quota).output
    assert "no error" in run("log", "check", beyond_quota).output
    run("replay", beyond_quota, "--json", tmp_path / "replay.json")
    result = json.loads((tmp_path / "replay.json").read_text())
    assert (result["episodes_without_motion"], result["differences"]) == (without, 0)
    run("log", "cut", beyond_quota, tmp_path / "last.lcm", "--episodes", "2")
    run("replay", tmp_path / "last.lcm", code=2)  # nothing in it to compute again is no success
