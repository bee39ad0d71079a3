"""The folder's own helpers are imported by name; small logs."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from spy_messages import episodes, write


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Four episodes: 8 s of motion in 38 s."""
    return write(tmp_path / "log.lcm", episodes(4))
