"""`tandem train TASK --from LOG`: training from an event log alone."""

from pathlib import Path
from typing import Any

from tandem.cli.common import fail, sentences
from tandem.cli.log import find


def train_from(
    task: str,
    source: Path,
    method: str | None,
    seed: int | None,
    run: Path | None,
    fresh: bool,
    overrides: list[str],
) -> None:
    from tandem import run_folder
    from tandem.learner.xla import configure
    from tandem.run_folder import RunFolder, shown

    configure()
    # JAX is imported below here, after its settings are made
    from tandem.learner.config import load_scenario
    from tandem.learner.offline import train_from

    log = find(source)
    with sentences():
        composed, discount = _scenario(log, task, method, seed, overrides)
        other_discount = composed.data["method"]["discount"] != discount
        name = f"{task}-{composed.run['method']}-seed{composed.run['seed']}-offline"
        folder = RunFolder((run or run_folder.RUNS / name).absolute())
        if folder.path == log.absolute().parent:
            fail(
                f"--run is the folder of {shown(log)} itself; give another, so that nothing there is overwritten.",
                2,
            )
        with folder.lock():
            if folder.path.exists():
                if not fresh:
                    fail(f"{shown(folder.path)} exists; --fresh sets it aside, --run DIR gives another.", 2)
                print(f"The old run is kept as {shown(folder.set_aside())}.")
            composed.write(folder.scenario)
            try:
                result = train_from(log, load_scenario(folder.scenario), folder, print, other_discount)
            except ValueError as error:
                fail(str(error))
    if result.missing:
        print(f"Not whole in the log, and left out: episodes {', '.join(map(str, result.missing))}.")
    buffer, comparison = result.buffer, result.comparison
    done = f"{result.updates} updates on {result.env_steps} env steps"
    print(f"{shown(folder.policy)}: policy {result.version} after {done}")
    print(f"buffer: {buffer['steps']} steps, sha256 {buffer['sha256']}{_said(comparison.buffer_equal)}")
    for version, equal in comparison.policies_equal.items():
        print(f"policy {version}:{_said(equal)}")
    run_folder.write_json(
        folder.path / "offline.json",
        {
            "log": str(log),
            "buffer": buffer,
            "env_steps": result.env_steps,
            "updates": result.updates,
            "buffer_equal": comparison.buffer_equal,
            "policies_equal": comparison.policies_equal,
            "missing_episodes": result.missing,
        },
    )
    if comparison.buffer_equal is False:
        fail("the buffer differs from the one that the run left: its log has lost or changed episodes since.")


def _said(equal: bool | None) -> str:
    return {None: "", True: " equals that of the run, to the bit", False: " differs from that of the run"}[
        equal
    ]


def _scenario(
    log: Path, task: str, method: str | None, seed: int | None, overrides: list[str]
) -> tuple[Any, float]:
    """The log's own scenario (with another method: today's config of it, the log's `run`), and the log's discount."""
    import tempfile

    from tandem import run_folder, scenario
    from tandem.log import scenario_yaml

    try:
        text = scenario_yaml(log)
    except ValueError as error:
        fail(str(error))
    with tempfile.TemporaryDirectory(prefix="tandem-") as folder:
        file = Path(folder) / "scenario.yaml"
        file.write_text(text, encoding="utf-8")
        recorded = scenario.load(file)
    if recorded.run["task"] != task:
        fail(f"{log} was recorded with task {recorded.run['task']}, not {task}.", 2)
    discount = recorded.data["method"]["discount"]
    if method is not None and method != recorded.run["method"]:
        kept = {key: value for key, value in recorded.run.items() if key not in ("task", "method")}
        recorded = scenario.compose(run_folder.CONFIG, task, method, kept)
    if seed is not None:
        recorded.run["seed"] = seed
    for assignment in overrides:
        recorded.override(assignment)
    return recorded, discount
