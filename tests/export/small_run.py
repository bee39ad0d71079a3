"""Small real runs, and the command line, for the tests of export and import."""

import subprocess
import sys

from typer.testing import CliRunner

from tandem import scenario
from tandem.cli.app import app
from tandem.processes import free_lcm_url
from tandem.run_folder import CONFIG, RunFolder, program

SMALL = [
    "run.demonstrations=2",
    "run.env_steps=60",
    "run.evaluation_every=40",
    "task.max_steps=40",
    "method.learner.warm_start_updates=20",
    "method.learner.updates_per_env_step=1",
    "method.learner.head.mlp.hidden=[16]",
    "method.learner.critic.hidden=[16]",
    "method.learner.replay.batch=16",
]


def compose(*overrides: str) -> scenario.Scenario:
    return scenario.compose(CONFIG, "peg", "mcbc", {"mode": "train", "seed": 5}, [*SMALL, *overrides])


def train(folder: RunFolder, setting: scenario.Scenario) -> None:
    """Controller, scripted operator and learner to their good ends, without the evaluations around them."""
    setting.write(folder.scenario)
    common = ["--scenario", folder.scenario, "--lcm-url", free_lcm_url()]
    learner = [sys.executable, "-m", "tandem.learner", *common, "--run", folder.path]
    operator = [program("tandem_operator"), *common]
    controller = [program("tandem_controller"), *common, "--run", folder.path]
    with (folder.path / "out.txt").open("w") as out:
        partners = [subprocess.Popen(list(map(str, c)), stdout=out, stderr=out) for c in (learner, operator)]
        try:
            done = subprocess.run(list(map(str, controller)), stdout=out, stderr=out, timeout=300)
            assert partners[0].wait(timeout=300) == 0 and done.returncode == 0, out_of(folder)
        finally:
            for process in partners:
                process.terminate()
                process.wait()


def out_of(folder: RunFolder) -> str:
    return (folder.path / "out.txt").read_text()[-3000:]


def invoke(*words: object) -> tuple[int, str]:
    """A command of ./tandem: exit code and output."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    return result.exit_code, result.output
