"""`./tandem policy`: NumPy's files in and out, and a sentence where something is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import heads
import numpy as np
import pytest
import runtime
from lerobot import Checkpoint
from typer.testing import CliRunner

from tandem.cli.app import app
from tandem.learner.golden import golden_examples
from tandem.policy_file import read_header, write_policy


@pytest.fixture
def policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TANDEM_BIN", str(runtime.BIN))
    typed, params = heads.network("mlp", heads.mlp(), 5, 2)
    zeros, ones = np.zeros(5, np.float32), np.ones(5, np.float32)
    golden = golden_examples("mlp", typed, params, 2, zeros, ones, np.random.default_rng(0))
    write_policy(tmp_path / "p", runtime.header("mlp", heads.mlp(), 5, 2), params, zeros, ones, golden)
    np.savez(tmp_path / "golden.npz", **golden)
    return tmp_path / "p"


def tandem(*words: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["policy", *(str(word) for word in words)])
    return result.exit_code, result.stderr


def test_run_takes_and_gives_numpys_files(policy: Path) -> None:
    folder = policy.parent
    golden = np.load(folder / "golden.npz")
    # in double, as NumPy makes numbers unless told otherwise
    np.savez(folder / "in.npz", observation=golden["observation"].astype(np.float64))
    assert tandem("run", policy, "--input", folder / "in.npz", "--output", folder / "out") == (0, "")
    chunk = np.load(folder / "out")["chunk"]
    assert chunk.dtype == np.float32
    np.testing.assert_allclose(chunk, golden["chunk"], rtol=0, atol=1e-5)


def test_run_names_a_file_that_it_can_not_read(policy: Path) -> None:
    folder = policy.parent
    (folder / "text.npz").write_text("no numbers")
    np.savez(folder / "words.npz", observation=["up", "down"])
    np.savez(folder / "image.npz", **{"image.top": np.zeros((1, 4, 4, 3))})
    for name in ("text.npz", "words.npz", "image.npz", "missing.npz"):
        code, sentence = tandem("run", policy, "--input", folder / name, "--output", folder / "out")
        assert code == 2 and f"{folder / name} is not an NPZ file of numbers, images in uint8" in sentence
    assert not (folder / "out").exists()


def test_run_leaves_no_output_when_the_runtime_refuses(policy: Path) -> None:
    folder = policy.parent
    np.savez(folder / "in.npz", observation=np.zeros((3, 4)))
    code, _ = tandem("run", policy, "--input", folder / "in.npz", "--output", folder / "out")
    assert code == 2 and not (folder / "out").exists()


def test_info_is_what_the_runtime_says(policy: Path, capfd: pytest.CaptureFixture[str]) -> None:
    code, _ = tandem("info", policy, "--json")
    facts = json.loads(capfd.readouterr().out)
    assert code == 0 and facts["architecture"] == "mlp" and facts["golden_error"] <= 1e-5


def test_convert_writes_a_policy_file_or_says_why_not(tmp_path: Path) -> None:
    checkpoint = Checkpoint()
    source, destination = checkpoint.save(tmp_path / "source"), tmp_path / "policy.safetensors"
    assert tandem("convert", source, destination) == (0, "")
    assert read_header(destination).architecture == "act"
    code, sentence = tandem("convert", tmp_path, destination)
    assert code == 2 and "give the folder of a LeRobot checkpoint" in sentence
