"""A real run, small: two demonstrations and a few training episodes, its log written by the real controller."""

import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
# Compiling takes most of a small run's time, so nothing is optimised; here as in the programs, which inherit it: equal
# programs give equal bits.
os.environ["XLA_FLAGS"] = "--xla_backend_optimization_level=0"

from small_run import compose, train

from tandem.export.source import Source, open_source
from tandem.learner.episode import Episode
from tandem.run_folder import ROOT, RunFolder

LEROBOT_PYTHON = ROOT / ".setup/lerobot/bin/python"


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    folder = RunFolder(tmp_path_factory.mktemp("export") / "run")
    train(folder, compose())
    return folder


@pytest.fixture(scope="session")
def source(run: RunFolder) -> Source:
    return open_source(run.log)


@pytest.fixture(scope="session")
def episodes(source: Source) -> list[Episode]:
    return list(source.episodes())


@pytest.fixture(scope="session")
def lerobot_python() -> Path:
    assert LEROBOT_PYTHON.exists(), f"{LEROBOT_PYTHON} is missing; ./tandem test installs it."
    return LEROBOT_PYTHON
