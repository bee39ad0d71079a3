"""A run's checkpoints and their evaluations: one at a time beside the training, the rest after it."""

import contextlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tandem import evaluation
from tandem.evaluation import Evaluation, EvaluationError
from tandem.run_clock import Clock
from tandem.run_folder import RunFolder
from tandem.scenario import Scenario


class Checkpoints:
    """Finds new checkpoints, evaluates each once (an earlier call's results count) and keeps the results."""

    def __init__(self, folder: RunFolder, scenario: Scenario) -> None:
        self.folder = folder
        self.scenario = scenario
        self.evaluated: dict[int, dict[str, Any]] = {}  # env_steps -> result
        self._queue = evaluation.Queue()
        for file in folder.evaluations.glob("[0-9]*.json"):
            with contextlib.suppress(OSError, ValueError, KeyError):
                value = json.loads(file.read_text())
                self.evaluated[int(value["env_steps"])] = value

    @property
    def running(self) -> list[str]:
        """Names of the evaluations that run now."""
        return self._queue.running

    def look(self, clock: Clock) -> None:
        """Notes when new checkpoints came and queues their evaluation."""
        for steps, policy in self.folder.checkpoints().items():
            trained_s = clock.value["seconds"].get("training", 0.0)
            clock.value["checkpoints"].setdefault(str(steps), trained_s)
            name = f"checkpoint {steps}"
            if steps not in self.evaluated and not self._queue.knows(name):
                episodes = self.scenario.run["evaluation_episodes"]
                result = self.folder.evaluation(steps)
                seed = evaluation.CHECKPOINT_SEED
                self._queue.add(self._job(name, policy, seed, episodes, result, env_steps=steps))

    def also(self, name: str, policy: Path | None, seed: int, episodes: int, file: str, **facts: Any) -> None:
        """Queues another evaluation of this run, unless its result is there."""
        result = self.folder.evaluations / file
        try:
            self._queue.done[name] = json.loads(result.read_text())
        except (OSError, ValueError):
            self._queue.add(self._job(name, policy, seed, episodes, result, **facts))

    def poll(self, slots: int) -> None:
        """Collects results and starts what waits. @raises EvaluationError when one failed."""
        for name in self._queue.poll(slots):
            if name in self._queue.failed:
                raise EvaluationError(self._queue.failed[name])
            if name.startswith("checkpoint "):
                value = self._queue.done[name]
                self.evaluated[value["env_steps"]] = value

    def finish(self, wait: Callable[[str], None]) -> dict[str, dict[str, Any]]:
        """Runs all that is queued, on all cores; results by name. `wait` is told meanwhile what is done."""
        while self._queue.pending:
            self.poll(evaluation.cores())
            wait(f"evaluating, {self._queue.pending} to go: {', '.join(self.running)}")
        return self._queue.done

    def stop(self) -> None:
        self._queue.stop()

    def _job(
        self, name: str, policy: Path | None, seed: int, episodes: int, result: Path, **facts: Any
    ) -> Evaluation:
        return Evaluation(
            name=name,
            scenario=self.scenario,
            policy=policy,
            seed=seed,
            episodes=episodes,
            folder=result.with_suffix(""),
            result=result,
            nice=evaluation.NICE,
            facts=facts,
        )
