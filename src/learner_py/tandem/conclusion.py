"""What follows a training: select, evaluate on fresh seeds, draw, sum up; parts that are done are skipped."""

import contextlib
import json
import shutil
from collections.abc import Callable
from typing import Any

from tandem_lcm.tandem.world_state_t import world_state_t

from tandem import evaluation, plot, run_report, summary, video
from tandem.checkpoints import Checkpoints
from tandem.run_clock import Clock
from tandem.run_folder import RunFolder, RunFolderError, shown, write_json
from tandem.scenario import Scenario, ScenarioError

OPERATOR_EPISODES = 50


def conclude(
    folder: RunFolder,
    scenario: Scenario,
    checkpoints: Checkpoints,
    clock: Clock,
    operator_kind: str,
    wait: Callable[[str], None],
    say: Callable[[str], None],
) -> dict[str, Any]:
    """Leaves policy.safetensors, curve.png, demo.mp4, summary.json and report.html in RUN/. Returns the summary.

    `wait` is called a few times a second with what is being done, and may raise to stop.
    """
    run = scenario.run
    checkpoints.look(clock)
    checkpoints.finish(wait)
    policies = folder.checkpoints()
    curve = [checkpoints.evaluated[steps] for steps in sorted(checkpoints.evaluated) if steps in policies]
    if not curve:
        raise evaluation.EvaluationError(
            f"The learner left no checkpoint in {shown(folder.path / 'checkpoints')}; see learner.out."
        )

    # The selected and the last checkpoint on seeds that selected nothing; the operator for comparison.
    selected, last = evaluation.select(curve)["env_steps"], max(policies)
    seed, episodes = evaluation.FRESH_SEED + run["seed"], run["fresh_episodes"]
    for steps in {selected, last}:
        file = f"fresh-{steps:07d}.json"
        checkpoints.also(f"fresh {steps}", policies[steps], seed, episodes, file, env_steps=steps)
    if operator_kind == "scripted":
        seed = evaluation.OPERATOR_SEED + run["seed"]
        checkpoints.also("operator", None, seed, OPERATOR_EPISODES, "operator.json")
    done = checkpoints.finish(wait)
    operator = done.get("operator") or operator_from_demonstrations(folder)

    partial = folder.policy.with_name("policy.part")
    shutil.copyfile(policies[selected], partial)
    partial.replace(folder.policy)
    draw(folder, scenario, curve, operator, wait, say)

    clock.spend("final evaluation")
    controller: dict[str, Any] = {}
    with contextlib.suppress(OSError, ValueError):
        controller = json.loads((folder.path / "controller.json").read_text())
    fresh = summary.Fresh(done[f"fresh {selected}"], done[f"fresh {last}"], operator)
    value = summary.build(folder, scenario, curve, fresh, clock.value, controller)
    write_json(folder.summary, value)
    try:
        run_report.write(folder)
    except (OSError, ScenarioError, RunFolderError) as error:
        say(f"report.html is left out: {error}")
    return value


def operator_from_demonstrations(folder: RunFolder) -> dict[str, Any]:
    """A person can't be asked for 50 episodes more: his figures come from the demonstrations in the log."""
    ends = [end for end in summary.read_episodes(folder.log) if end.phase == world_state_t.DEMONSTRATION]
    fields = ("outcome", "n_steps", "force_peak", "force_filtered_peak")
    return evaluation.summarise({"episodes": [{key: getattr(end, key) for key in fields} for end in ends]})


def draw(
    folder: RunFolder,
    scenario: Scenario,
    curve: list[dict[str, Any]],
    operator: dict[str, Any],
    wait: Callable[[str], None],
    say: Callable[[str], None],
) -> None:
    """curve.png and demo.mp4; a machine that can't draw videos gets a sentence instead."""
    run = scenario.run
    plot.curve(
        folder.path / "curve.png",
        f"{run['task']} · {run['method']} · seed {run['seed']}",
        curve,
        summary.training_episodes(summary.read_episodes(folder.log)),
        summary.read_progress(folder.progress),
        operator["success"],
    )
    out, episodes = folder.path / "demo.mp4", run["video_episodes"]
    if out.exists() or episodes == 0:
        return
    seed, workspace = evaluation.DEMO_SEED + run["seed"], folder.evaluations / "demo"
    try:
        video.of_policy(
            folder.policy, scenario, seed, episodes, workspace, out, lambda: wait("drawing demo.mp4")
        )
    except (evaluation.EvaluationError, OSError) as error:
        say(f"demo.mp4 is left out: {error}")
