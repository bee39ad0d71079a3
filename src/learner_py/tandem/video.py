"""Videos of episodes, drawn offline from an event log by tandem_render."""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tandem import processes
from tandem.evaluation import Evaluation, EvaluationError
from tandem.processes import Child
from tandem.run_folder import program
from tandem.scenario import Scenario


def of_policy(
    policy: Path,
    scenario: Scenario,
    seed: int,
    episodes: int,
    folder: Path,
    out: Path,
    wait: Callable[[], None] = lambda: time.sleep(0.1),
) -> dict[str, Any]:
    """Runs a few episodes of a policy and draws them to `out`. Returns the episodes' figures.

    @raises EvaluationError when either fails, with a sentence.
    """
    job = Evaluation(
        name="demo",
        scenario=scenario,
        policy=policy,
        seed=seed,
        episodes=episodes,
        folder=folder,
        robot_state_hz=100,
    )
    value = job.run(wait)
    of_log(folder / "log.lcm", out, episodes, folder / "render.out", wait)
    return value


def of_log(
    log: Path,
    out: Path,
    episodes: int,
    output: Path,
    wait: Callable[[], None] = lambda: time.sleep(0.1),
) -> None:
    """Draws a log's first episodes by tandem_render, without a screen; `output` takes what the renderer says.

    @raises EvaluationError when there is no way to draw.
    """
    partial = out.with_name(f"{out.stem}.part{out.suffix}")
    command: processes.Command = [program("tandem_render"), log, partial, "--episodes", str(episodes)]
    if sentence := processes.missing_program(command):
        raise EvaluationError(sentence)
    environment = {"EGL_PLATFORM": os.environ.get("EGL_PLATFORM", "surfaceless")}
    render = Child("renderer", command, output, environment=environment)
    try:
        while render.poll() is None:
            wait()
        if render.poll() != 0 or not partial.exists():
            raise EvaluationError(render.death())
        partial.replace(out)
    finally:
        render.stop(5.0)
