"""The wire: what every message promises, and that none can be taken for another."""

import importlib
import re
from pathlib import Path
from typing import Any

import pytest

FILES = sorted((Path(__file__).parents[2] / "lcm_types").glob("*.lcm"))
NAMES = [file.stem for file in FILES]


def message(name: str) -> Any:
    return getattr(importlib.import_module(f"tandem_lcm.tandem.{name}"), name)


def fields(file: Path) -> list[str]:
    """Lines that declare a field (constants left out)."""
    body = file.read_text().split("{", 1)[1].rsplit("}", 1)[0]
    lines = [line.strip() for line in body.splitlines()]
    return [line for line in lines if re.match(r"(int|float|double|string|boolean|byte)", line)]


@pytest.mark.parametrize("file", FILES, ids=NAMES)
def test_one_struct_a_file_with_utime_first(file: Path) -> None:
    text = file.read_text()
    assert text.startswith("package tandem;")
    assert re.findall(r"^struct (\w+)", text, re.MULTILINE) == [file.stem]
    assert re.match(r"int64_t utime;\s+// us", fields(file)[0])


@pytest.mark.parametrize("file", FILES, ids=NAMES)
def test_every_number_says_its_unit_or_meaning(file: Path) -> None:
    silent = [line for line in fields(file) if "//" not in line]
    # a plain name or count may speak for itself; what is measured or commanded may not
    allowed = {"n_observation", "episodes_trained_through", "missing_steps"}
    assert [line for line in silent if not any(name in line for name in allowed)] == []


def test_no_two_types_decode_as_each_other() -> None:
    fingerprints = [message(name)._get_packed_fingerprint() for name in NAMES]
    assert len(set(fingerprints)) == len(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_round_trip_keeps_every_byte(name: str) -> None:
    encoded = message(name)().encode()
    assert message(name).decode(encoded).encode() == encoded
    with pytest.raises(ValueError):
        message(name).decode(b"\0" * 8 + encoded[8:])
