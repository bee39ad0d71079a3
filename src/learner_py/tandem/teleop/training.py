"""What a training run is doing, seen from beside it: its messages, and the notices in RUN/train.out."""

import json
import time
from pathlib import Path
from typing import Any

from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.learner_status_t import learner_status_t

from tandem import live_view
from tandem.run_folder import RunFolder
from tandem.scenario import Scenario
from tandem.wire import Wire

_LOOK_EVERY_S = 2.0  # at the files
_TAIL_BYTES = 4096


class Training:
    """Rows for the screen."""

    def __init__(self, wire: Wire, folder: RunFolder, scenario: Scenario) -> None:
        self._folder, self._scenario = folder, scenario
        self._progress = live_view.Progress()
        self._evaluated: dict[int, dict[str, Any]] = {}
        self._notice = ""
        self._looked = -_LOOK_EVERY_S
        wire.subscribe(episode_end_t, lambda end, _: self._progress.on_episode(end))
        wire.subscribe(learner_status_t, lambda _, data: self._progress.on_learner(data))

    def on_status(self, status: Any) -> None:
        self._progress.take_status(status)

    def rows(self) -> dict[str, str]:
        now = time.monotonic()
        if now - self._looked > _LOOK_EVERY_S:
            self._looked = now
            self._notice = last_notice(self._folder.progress_text)
            self._evaluated = _evaluated(self._folder)
        shown = live_view.rows(self._progress, self._scenario, self._evaluated, [])
        for told_elsewhere in ("phase", "arm", "waiting for"):
            shown.pop(told_elsewhere, None)
        if self._notice:
            shown["training"] = self._notice
        return shown


def last_notice(file: Path) -> str:
    """The last line that is not one of the regular reports, which begin with [."""
    try:
        with file.open("rb") as text:
            text.seek(max(0, text.seek(0, 2) - _TAIL_BYTES))
            lines = text.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return ""
    notices = [line.strip() for line in lines if line.strip() and not line.startswith("[")]
    return notices[-1] if notices else ""


def _evaluated(folder: RunFolder) -> dict[int, dict[str, Any]]:
    found = {}
    for file in folder.evaluations.glob("[0-9]*.json"):
        try:
            value = json.loads(file.read_text())
            found[int(value["env_steps"])] = value
        except (OSError, ValueError, KeyError):
            continue
    return found
