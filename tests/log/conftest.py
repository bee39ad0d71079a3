"""Where tests write logs."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

for _folder in ("learner_py", "support", "log"):  # support.py, heads.py, handmade.py
    sys.path.insert(0, str(Path(__file__).parents[1] / _folder))


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes pieces of bytes to a log."""

    def _write(*pieces: bytes, name: str = "log.lcm") -> Path:
        path = tmp_path / name
        path.write_bytes(b"".join(pieces))
        return path

    return _write


@pytest.fixture(scope="session")
def real_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two demonstrations by the scripted operator, recorded by the controller: a second of work."""
    from tandem import run_folder, scenario
    from tandem.evaluation import Evaluation

    folder = tmp_path_factory.mktemp("real") / "run"
    composed = scenario.compose(run_folder.CONFIG, "peg", "tandem", {})
    Evaluation("demonstrations", composed, None, 5_000_000, 2, folder, robot_state_hz=100).run()
    return folder / "log.lcm"
