"""One run of an experiment: what is trained, where it lands, and the command that does it."""

import shlex
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tandem import scenario
from tandem.run_folder import CONFIG, RunFolder, shown
from tandem.scenario import Origin, Scenario, ScenarioError


@dataclass(frozen=True)
class Setting:
    """An override `a.b=c`, and where a person wrote it (`config/ablations/critic.yaml:9`, or `--set a.b=c`)."""

    assignment: str
    place: str

    @property
    def key(self) -> str:
        return self.assignment.partition("=")[0].strip()


def typed(overrides: Sequence[str] | None) -> tuple[Setting, ...]:
    """Settings from the command line's --set."""
    return tuple(Setting(assignment, f"--set {assignment}") for assignment in overrides or [])


@dataclass(frozen=True)
class Run:
    """label: the row of the table that it belongs to; runs of one label differ by their seed only."""

    label: str
    task: str
    method: str
    seed: int
    folder: RunFolder
    settings: tuple[Setting, ...] = ()

    def __str__(self) -> str:
        return f"{self.label}, seed {self.seed}"

    @property
    def out(self) -> Path:
        """What its command says; beside the folder, which the command may set aside."""
        return self.folder.path.with_name(self.folder.path.name + ".out")

    @property
    def finished(self) -> bool:
        return self.folder.summary.exists()

    def command(self) -> list[str]:
        """As a person would type it, but for the program's name; a second call goes on where the first stopped."""
        overrides = [word for setting in self.settings for word in ("--set", setting.assignment)]
        options = ["--method", self.method, "--seed", str(self.seed), "--run", str(self.folder.path)]
        return [sys.executable, "-m", "tandem", "train", self.task, *options, *overrides]

    def typed_command(self) -> str:
        """The same for a person's terminal."""
        return shlex.join(["./tandem", *self.command()[3:]])

    def scenario(self, config: Path = CONFIG) -> Scenario:
        """The scenario that the command composes. @raises ScenarioError naming the place of the wrong value."""
        values = {"mode": "train", "seed": self.seed, "clock": "lockstep"}
        composed = scenario.compose(config, self.task, self.method, values)
        for setting in self.settings:
            try:
                composed.override(setting.assignment)
            except ScenarioError as error:
                text = str(error).replace(f"--set {setting.assignment}", setting.place, 1)
                raise ScenarioError(text) from None
            composed.origins[setting.key] = Origin(setting.place, 0)
        scenario.validate_run(composed)
        return composed


def check(runs: Sequence[Run], config: Path = CONFIG) -> None:
    """Refuses wrong runs before any of them starts: scenarios that don't compose, methods whose parts don't fit,
    finished runs of another scenario (they would be shown under a label that they are not).

    @raises ScenarioError with the run and the place of the wrong value.
    """
    sound: dict[str, Scenario] = {}  # by label: runs of one label differ by their seed only
    for run in runs:
        try:
            if run.label not in sound:
                sound[run.label] = run.scenario(config)
                _ask_learner(sound[run.label])
            composed = sound[run.label].copy_with(seed=run.seed)
            scenario.validate_run(composed)
        except ScenarioError as error:
            raise ScenarioError(f"{run}: {error}") from None
        if not run.finished or not run.folder.scenario.exists():
            continue
        if difference := composed.first_difference(scenario.load(run.folder.scenario)):
            raise ScenarioError(
                f"{shown(run.folder.path)} holds a finished run of another scenario: {difference}."
                " Give --collect-only to show it as it is, another folder by --runs, or move it away."
            )


def _ask_learner(composed: Scenario) -> None:
    """Whether the learner can train this; the programs in C++ judge their sections when a run starts."""
    from tandem.learner.config import load_scenario

    with tempfile.TemporaryDirectory(prefix="tandem-check-") as folder:
        file = Path(folder) / "scenario.yaml"
        composed.write(file)
        try:
            load_scenario(file)
        except ScenarioError as error:
            raise ScenarioError(composed.explain(str(error))) from None
