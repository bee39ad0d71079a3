import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
sys.path.insert(0, str(Path(__file__).parent))

from tandem.learner.xla import configure

configure()

_compiled = {}


@pytest.fixture(autouse=True)
def compile_once(monkeypatch):
    """Compiling takes most of a test's time: tests of the same method share the jitted update, which has no state."""
    from tandem.learner import trainer, update

    def cached(method):
        outside = {"learner": {"updates_per_env_step", "warm_start_updates", "checkpoint_every_s"}}
        key = method.config.model_dump_json(exclude=outside) + method.scenario.task.model_dump_json()
        if key not in _compiled:
            _compiled[key] = update.make_update(method)
        return _compiled[key]

    monkeypatch.setattr(trainer, "make_update", cached)
