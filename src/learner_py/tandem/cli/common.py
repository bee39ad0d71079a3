"""What the commands share: options, failing with a sentence, finding policies and their scenarios."""

import contextlib
import json
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from tandem import run_folder, scenario
from tandem.run_folder import RunFolder, RunFolderError
from tandem.scenario import Scenario, ScenarioError

JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the figures as JSON to FILE (- = stdout)."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override a scenario value, e.g. run.env_steps=4000; repeatable."
    ),
]


def fail(sentence: str, code: int = 1) -> NoReturn:
    print(f"tandem: {sentence}", file=sys.stderr, flush=True)
    raise typer.Exit(code)


@contextlib.contextmanager
def sentences() -> Iterator[None]:
    """Turns our own errors into one sentence on stderr and an exit code; Ctrl-C into 130."""
    from tandem.evaluation import EvaluationError

    try:
        yield
    except ScenarioError as error:
        fail(str(error), 2)
    except (RunFolderError, EvaluationError) as error:
        fail(str(error), 1)
    except KeyboardInterrupt:
        fail("stopped.", 130)


def write_json(file: Path | None, value: Any) -> None:
    if file is None:
        return
    if str(file) == "-":
        print(json.dumps(value, indent=2))
        return
    try:
        run_folder.write_json(file, value)
    except OSError as error:
        fail(f"{file} can't be written ({error.strerror}).")


def same_command() -> str:
    """The command line that was typed, to be typed again; --fresh would undo what resuming is for."""
    return shlex.join(["./tandem", *(word for word in sys.argv[1:] if word != "--fresh")])


def find_policy(policy: Path | None) -> Path:
    """A policy file from a file, a run folder, or nothing (the newest run that has a policy)."""
    if policy is None:
        found = sorted(run_folder.RUNS.glob("*/policy.safetensors"), key=lambda file: file.stat().st_mtime)
        if not found:
            fail(
                "no run below runs/ has a policy yet; train one by ./tandem train peg, or name a file.",
                2,
            )
        return found[-1]
    if policy.is_dir():
        policy = RunFolder(policy).policy
    if not policy.is_file():
        fail(
            f"{policy} does not exist; give a policy file (.safetensors) or the folder of a finished run.", 2
        )
    return policy


def scenario_of(policy: Path, overrides: list[str]) -> Scenario:
    """The scenario that a policy was trained in: its run's, else today's config of its task and method."""
    for folder in (policy.resolve().parent, policy.resolve().parent.parent):
        if (file := RunFolder(folder).scenario).is_file():
            found = scenario.load(file)
            break
    else:
        metadata = run_folder.policy_metadata(policy)
        found = scenario.compose(run_folder.CONFIG, metadata["task"], metadata["method"], {})
    for assignment in overrides:
        found.override(assignment)
    return found
