import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
sys.path.insert(0, str(Path(__file__).parent))

from tandem.learner.xla import configure

configure()

_compiled = {}


@pytest.fixture(autouse=True, scope="session")
def compile_once():
    """Compiling takes most of a test's time: tests of the same method share the jitted update, which has no state, and
    it is not optimised. For the whole session, so that fixtures get the same bits as tests."""
    import jax

    from tandem.learner import trainer, update

    def quick_jit(function, **options):
        return jax.jit(function, compiler_options={"xla_backend_optimization_level": 0}, **options)

    def cached(method):
        outside = {"learner": {"updates_per_env_step", "warm_start_updates", "checkpoint_every_s"}}
        shared = {"name", "execution"}
        key = method.config.model_dump_json(exclude=outside | dict.fromkeys(shared, True))
        key += method.scenario.task.model_dump_json() + method.scenario.run.observe
        if key not in _compiled:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(update, "jax", _With(jax, jit=quick_jit))
                _compiled[key] = update.make_update(method)
        return _compiled[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer, "make_update", cached)
        yield


class _With:
    """A module with some of its names replaced."""

    def __init__(self, module, **names):
        self._module = module
        self.__dict__.update(names)

    def __getattr__(self, name):
        return getattr(self._module, name)
