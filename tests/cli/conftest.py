"""A small config and stand-ins for the programs: the command line is tested without building or training."""

import os
import stat
import sys
from pathlib import Path

import pytest

FAKES = Path(__file__).parent / "fakes"

RUN = """\
mode: train
task: peg
method: tandem
seed: 0
clock: lockstep
demonstrations: 2
env_steps: 60
learner_lag: 1
evaluation_every: 20
evaluation_episodes: 10
fresh_episodes: 12
video_episodes: 2
episodes: 5
policy: ""
robot_state_hz: 100
log_file_mb: 0
log_quota_mb: 0
observe: state
"""
TASK = """\
# a task
name: peg
policy_rate_hz: 10
max_steps: 120
observation: [tool_x, tool_y]
action_axes: [x, y, z, rz]
"""
CONTROLLER = """\
stiffness:
  translation: [2000, 2000, 2000]   # N/m
  rotation: [50, 50, 50]
clip: 1e-2
"""
OPERATOR = "reaction_delay: 0.2\nskilled: true\n"
METHOD = """\
discount: 0.98
horizon: 1
learner:
  batch: 256
  head:
    kind: mlp
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A config folder with one task and two methods."""
    folder = tmp_path / "config"
    files = {
        "run.yaml": RUN,
        "tasks/peg.yaml": TASK,
        "controller.yaml": CONTROLLER,
        "operator.yaml": OPERATOR,
        "method.yaml": METHOD,
        "methods/tandem.yaml": "name: tandem\nlearner:\n  head: {kind: flow}\n",
        "methods/mcbc.yaml": "name: mcbc\n",
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand-ins for the built programs and for the learner; FAKE_* variables change what they do."""
    folder = tmp_path / "bin"
    folder.mkdir()
    scripts = {"controller": "controller", "operator": "scripted_operator", "render": "render"}
    for name, script in scripts.items():
        file = folder / f"tandem_{name}"
        file.write_text(f'#!/bin/sh\nexec {sys.executable} {FAKES}/{script}.py "$@"\n')
        file.chmod(file.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("TANDEM_BIN", str(folder))
    monkeypatch.setenv("TANDEM_LEARNER", f"{sys.executable} {FAKES}/learner.py")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    monkeypatch.delenv("LCM_DEFAULT_URL", raising=False)
    return folder
