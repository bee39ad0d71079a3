"""A log is a training set: what a run learnt can be learnt again from it, to the bit."""

import json
import shutil
from pathlib import Path

import lcm
import numpy as np
from small_run import invoke

from tandem.log import raw_events
from tandem.policy_file import read_safetensors
from tandem.run_folder import RunFolder


def test_log_gives_the_runs_buffer_and_policies_again(run: RunFolder, tmp_path: Path) -> None:
    code, output = invoke("train", "peg", "--from", run.path, "--run", tmp_path / "again")
    assert code == 0, output
    value = json.loads((tmp_path / "again/offline.json").read_text())
    assert value["buffer"] == json.loads(run.buffer.read_text())
    assert value["buffer_equal"] is True and value["buffer"]["steps"] > 60
    last = max(run.policies())
    assert value["policies_equal"][str(last)] is True and len(value["policies_equal"]) >= 2
    ours, _ = read_safetensors(tmp_path / "again/policy.safetensors")
    theirs, _ = read_safetensors(run.policies()[last])
    assert all(np.array_equal(ours[name], theirs[name]) for name in theirs)


def test_log_in_several_files_gives_the_same_buffer(run: RunFolder, tmp_path: Path) -> None:
    split = RunFolder(tmp_path / "split")
    (split.path / "learner").mkdir(parents=True)
    for file in (run.scenario, run.buffer):
        shutil.copy(file, split.path / file.relative_to(run.path))
    files = [split.log, split.log.with_name(split.log.name + ".01")]
    logs, n_ends = [lcm.EventLog(str(file), "w") for file in files], 0
    for event in raw_events(run.log):
        logs[n_ends > 2].write_event(event.timestamp, event.channel, event.data)
        n_ends += event.channel == "EPISODE_END"
    for log in logs:
        log.close()
    code, output = invoke("train", "peg", "--from", split.path, "--run", tmp_path / "again")
    assert code == 0, output
    assert json.loads((tmp_path / "again/offline.json").read_text())["buffer_equal"] is True


def test_log_that_lost_an_episode_is_told_from_a_whole_one(run: RunFolder, tmp_path: Path) -> None:
    """And it is a training set all the same."""
    lost = RunFolder(tmp_path / "lost")
    (lost.path / "learner").mkdir(parents=True)
    for file in (run.scenario, run.buffer):
        shutil.copy(file, lost.path / file.relative_to(run.path))
    log, n_ends = lcm.EventLog(str(lost.log), "w"), 0
    for event in raw_events(run.log):
        n_ends += event.channel == "EPISODE_END"
        if event.channel != "EPISODE_END" or n_ends != 3:
            log.write_event(event.timestamp, event.channel, event.data)
    log.close()
    code, output = invoke("train", "peg", "--from", lost.path, "--run", tmp_path / "again")
    assert code == 1 and "left out: episodes 2." in output and "buffer differs" in output
    assert (tmp_path / "again/policy.safetensors").exists()


def test_another_discount_than_the_logs_makes_returns_anew(run: RunFolder, tmp_path: Path) -> None:
    """What comes out is compared with nothing: it is another training."""
    options = ("--set", "method.discount=0.5", "--set", "method.learner.updates_per_env_step=0")
    code, output = invoke("train", "peg", "--from", run.path, "--run", tmp_path / "again", *options)
    assert code == 0 and "that of the run" not in output, output


def test_what_cannot_be_learnt_from_is_refused_with_a_sentence(run: RunFolder, tmp_path: Path) -> None:
    for words, sentence in {
        ("peg", "--from", tmp_path / "none"): "does not exist",
        ("square", "--from", run.path): "was recorded with task peg, not square",
        ("peg", "--from", run.path, "--run", run.path): "is the folder of",
        ("peg", "--from", run.path, "--run", tmp_path): "exists; --fresh sets it aside",
        (
            "peg",
            "--from",
            run.path,
            "--set",
            "run.demonstrations=9",
        ): "only 2 of 9 demonstrations came before it",
        ("peg", "--from", run.path, "--method", "nonsense"): "nonsense",
    }.items():
        words = words if "--run" in words else (*words, "--run", tmp_path / sentence[:12])
        code, output = invoke("train", *words)
        assert code != 0 and sentence in output and "Traceback" not in output, output
