"""Evaluations: autonomous, noise-free episodes of a policy (or of the operator alone) on unseen seeds.

Each is one `tandem_controller` process with a scenario of its own in lockstep. Seeds by purpose, apart from
the training seeds [0, 999999]:
  CHECKPOINT_SEED              the same episodes for every checkpoint of every method and training seed
  FRESH_SEED + training seed   never used for selecting anything
  OPERATOR_SEED + training seed
  DEMO_SEED + seed             `tandem demo`
"""

import json
import math
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tandem import processes
from tandem.run_folder import policy_metadata, program, write_json
from tandem.scenario import LOG_LIMITS, Scenario
from tandem.statistics import mean, wilson

CHECKPOINT_SEED = 1_000_000
FRESH_SEED = 2_000_000
OPERATOR_SEED = 4_000_000
DEMO_SEED = 6_000_000

NICE = 5  # beside a training run the arm and the learner go first


class EvaluationError(Exception):
    """A sentence: which evaluation failed and why."""


@dataclass
class Evaluation:
    """One evaluation: what to run and where the result goes.

    policy None: the scripted operator alone. `folder` holds scenario, log and output; it is made anew.
    """

    name: str
    scenario: Scenario
    policy: Path | None
    seed: int
    episodes: int
    folder: Path
    result: Path | None = None
    robot_state_hz: int = 0
    lcm_url: str | None = None
    nice: int = 0
    facts: dict[str, Any] = field(default_factory=dict)  # copied into the result

    def start(self) -> None:
        """Starts the processes; poll() tells when they are done."""
        if self.policy is not None:
            metadata = policy_metadata(self.policy)
            self.facts = {
                "env_steps": int(metadata.get("env_steps", 0)),
                "updates": int(metadata.get("updates", 0)),
                "policy": str(self.policy),
                **self.facts,
            }
        command = program("tandem_controller")
        if sentence := processes.missing_program([command]):
            raise EvaluationError(sentence)
        if self.folder.exists():
            shutil.rmtree(self.folder)
        self.folder.mkdir(parents=True)
        scenario_file = self.folder / "scenario.yaml"
        self.scenario.copy_with(
            mode="evaluate" if self.policy else "demonstrate",
            seed=self.seed,
            episodes=self.episodes,
            clock="lockstep",
            policy=str(self.policy.resolve()) if self.policy else "",
            robot_state_hz=self.robot_state_hz,
            **dict.fromkeys(LOG_LIMITS, 0),  # of the training's own log
        ).write(scenario_file)
        # Nobody needs to hear a policy's evaluation, so it stays in the process unless an address is given.
        url = self.lcm_url or ("memq://" if self.policy else processes.free_lcm_url())
        common: processes.Command = ["--scenario", scenario_file, "--lcm-url", url]
        self.started = time.monotonic()
        self.controller = processes.Child(
            "controller of the evaluation",
            [command, *common, "--run", self.folder, "--results", self.folder / "results.json"],
            self.folder / "controller.out",
            nice=self.nice,
        )
        self.operator = None
        if self.policy is None:
            self.operator = processes.Child(
                "operator of the evaluation",
                [program("tandem_operator"), *common],
                self.folder / "operator.out",
                nice=self.nice,
            )

    def poll(self) -> dict[str, Any] | None:
        """The result once it is there (also written to `result`), else None.

        @raises EvaluationError when a process failed.
        """
        code = self.controller.poll()
        if code is None:
            if self.operator is not None and self.operator.poll() not in (None, 0):
                self.stop()
                raise EvaluationError(f"{self.name}: {self.scenario.explain(self.operator.death())}")
            return None
        if self.operator is not None:
            self.operator.stop(5.0)
        if code != 0:
            raise EvaluationError(f"{self.name}: {self.scenario.explain(self.controller.death())}")
        try:
            raw = json.loads((self.folder / "results.json").read_text())
            value = {
                **self.facts,
                **summarise(raw),
                "seed": self.seed,
                "wall_s": time.monotonic() - self.started,
            }
        except (OSError, ValueError, KeyError) as error:
            raise EvaluationError(
                f"{self.name}: the controller left no usable {self.folder / 'results.json'} ({error})."
            ) from None
        if self.result is not None:
            write_json(self.result, value)
        return value

    def run(self, wait: Callable[[], None] = lambda: time.sleep(0.05)) -> dict[str, Any]:
        """start(), and `wait` until the result is there."""
        self.start()
        try:
            while (value := self.poll()) is None:
                wait()
            return value
        finally:
            self.stop()

    def stop(self) -> None:
        """Ends what still runs."""
        for child in (getattr(self, "controller", None), getattr(self, "operator", None)):
            if child is not None and child.poll() is None:
                child.stop(5.0)


def summarise(raw: dict[str, Any]) -> dict[str, Any]:
    """Figures of an evaluation from the controller's results; means of steps over successful episodes."""
    episodes = raw["episodes"]
    successes = [e for e in episodes if succeeded(e)]
    low, high = wilson(len(successes), len(episodes))
    peaks = [e["force_peak"] for e in episodes]
    filtered = [e["force_filtered_peak"] for e in episodes]
    return {
        "success": len(successes) / len(episodes) if episodes else 0.0,
        "successes": len(successes),
        "episodes": len(episodes),
        "wilson": [low, high],
        "steps_mean": mean([e["n_steps"] for e in successes]),
        "force": {
            "peak_mean": mean(peaks),
            "peak_max": max(peaks, default=None),
            "filtered_peak_mean": mean(filtered),
            "filtered_peak_max": max(filtered, default=None),
        },
        "env_steps_per_s": raw.get("env_steps_per_s"),
        "per_episode": episodes,
    }


def succeeded(episode: dict[str, Any]) -> bool:
    """Whether an episode is a success; its outcome may be a name or episode_end_t's number."""
    return episode["outcome"] in (0, "success", "SUCCESS")


def select(evaluations: list[dict[str, Any]]) -> dict[str, Any]:
    """The checkpoint to keep: highest success, then shortest successful episodes, then the later one."""
    return max(
        evaluations,
        key=lambda e: (
            e["success"],
            -(e["steps_mean"] if e["steps_mean"] is not None else math.inf),
            e["env_steps"],
        ),
    )


class Queue:
    """Runs evaluations a few at a time; call poll() often."""

    def __init__(self) -> None:
        self._waiting: list[Evaluation] = []
        self._running: list[Evaluation] = []
        self.done: dict[str, dict[str, Any]] = {}  # name -> result
        self.failed: dict[str, str] = {}  # name -> sentence

    def add(self, evaluation: Evaluation) -> None:
        self._waiting.append(evaluation)

    def knows(self, name: str) -> bool:
        waiting_or_running = (e.name for e in [*self._waiting, *self._running])
        return name in self.done or name in self.failed or name in waiting_or_running

    @property
    def pending(self) -> int:
        return len(self._waiting) + len(self._running)

    @property
    def running(self) -> list[str]:
        return [e.name for e in self._running]

    def poll(self, slots: int) -> list[str]:
        """Collects what is done and starts waiting ones on `slots`. Returns the names that ended just now."""
        ended = []
        for evaluation in list(self._running):
            try:
                value = evaluation.poll()
            except EvaluationError as error:
                self.failed[evaluation.name] = str(error)
            else:
                if value is None:
                    continue
                self.done[evaluation.name] = value
            self._running.remove(evaluation)
            ended.append(evaluation.name)
        while self._waiting and len(self._running) < slots:
            evaluation = self._waiting.pop(0)
            try:
                evaluation.start()
            except Exception as error:
                self.failed[evaluation.name] = f"{evaluation.name}: {error}"
                ended.append(evaluation.name)
            else:
                self._running.append(evaluation)
        return ended

    def stop(self) -> None:
        """Ends what runs, forgets what waits."""
        self._waiting.clear()
        for evaluation in self._running:
            evaluation.stop()
        self._running.clear()


def cores() -> int:
    """Cores that this process may use."""
    return max(1, len(os.sched_getaffinity(0)))
