"""What lies in a run folder, finished or not, for whoever shows it."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tandem import scenario, summary
from tandem.run_folder import RunFolder, RunFolderError, shown
from tandem.scenario import Scenario


@dataclass
class Facts:
    """Parts that are not there yet are empty."""

    folder: RunFolder
    scenario: Scenario
    summary: dict[str, Any] | None
    episodes: list[Any] = field(default_factory=list)  # EPISODE_END of training
    demonstrations: list[Any] = field(default_factory=list)  # EPISODE_END of the others
    progress: list[dict[str, float]] = field(default_factory=list)
    evaluations: list[dict[str, Any]] = field(default_factory=list)  # ascending by env steps
    controller: dict[str, Any] = field(default_factory=dict)


def read(folder: RunFolder) -> Facts:
    """@raises RunFolderError or ScenarioError with a sentence when it is no run folder."""
    if not folder.scenario.is_file():
        raise RunFolderError(
            f"{shown(folder.path)} is no run folder: it has no scenario.yaml; give one that ./tandem train made."
        )
    facts = Facts(folder, scenario.load(folder.scenario), _json(folder.summary))
    ends = summary.read_episodes(folder.log)
    facts.episodes = summary.training_episodes(ends)
    known = {end.episode for end in facts.episodes}
    facts.demonstrations = [end for end in ends if end.episode not in known]
    facts.progress = summary.read_progress(folder.progress)
    found = [_json(file) for file in sorted(folder.evaluations.glob("[0-9]*.json"))]
    facts.evaluations = sorted((value for value in found if value), key=lambda value: value["env_steps"])
    facts.controller = _json(folder.path / "controller.json") or {}
    return facts


def _json(path: Path) -> dict[str, Any] | None:
    try:
        value = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return value if isinstance(value, dict) else None
