"""Where tests write logs."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # handmade.py


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes pieces of bytes to a log."""

    def _write(*pieces: bytes, name: str = "log.lcm") -> Path:
        path = tmp_path / name
        path.write_bytes(b"".join(pieces))
        return path

    return _write
