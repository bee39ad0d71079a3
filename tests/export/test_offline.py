"""A log is a training set: what a run learnt can be learnt again from it, to the bit."""

import json
from pathlib import Path

import numpy as np
from small_run import invoke

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
