"""A converted LeRobot checkpoint computes what LeRobot computes, and one that can't be followed is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import runtime
from lerobot import ENVIRONMENT, STATE, Checkpoint

from tandem.lerobot_act import convert
from tandem.policy_file import PolicyFileError, network, read_header, read_safetensors

TOLERANCE = 1e-5  # action units
CAMERAS = {"observation.images.top": (40, 52), "observation.images.wrist": (33, 47)}
MEAN_STD = {"VISUAL": "MEAN_STD", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"}
MIN_MAX = {"STATE": "MIN_MAX", "ENV": "MIN_MAX", "ACTION": "MIN_MAX"}

# processors (the newer format), modes
FORMATS = [
    (True, MEAN_STD),  # ENV is not named: it stays as it is
    (False, MEAN_STD),
    (True, MIN_MAX),
    (False, MIN_MAX),
    (True, {"STATE": "QUANTILES", "ENV": "MEAN_STD", "ACTION": "QUANTILES"}),
    (True, {"STATE": "IDENTITY", "ACTION": "IDENTITY"}),
]


def batch(checkpoint: Checkpoint, n: int = 8) -> dict[str, np.ndarray]:
    """Raw inputs by LeRobot's keys; images are (n, 3, H, W) in [0, 1], from bytes."""
    generator, found = np.random.default_rng(3), {}
    for key, feature in checkpoint.settings["input_features"].items():
        shape = (n, *feature["shape"])
        if feature["type"] == "VISUAL":
            found[key] = generator.integers(0, 256, shape) / 255
        else:
            found[key] = generator.normal(0, 0.7, shape).astype(np.float32)
    return found


def our_inputs(raw: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    parts = [raw[key] for key in (STATE, ENVIRONMENT) if key in raw]
    inputs = {"observation": np.concatenate(parts, axis=1)}
    for key, image in raw.items():
        if "images" in key:
            pixels = np.rint(image * 255).astype(np.uint8).transpose(0, 2, 3, 1)
            inputs[f"image.{key.removeprefix('observation.images.')}"] = pixels
    return inputs


def jax_chunk(file: Path, inputs: dict[str, np.ndarray]) -> np.ndarray:

    from tandem.learner.golden import policy_chunk
    from tandem.learner.networks import read_config

    tensors, _ = read_safetensors(file)
    config = read_config("act", read_header(file).config)
    images = {name[6:]: array for name, array in inputs.items() if name.startswith("image.")}
    nothing = np.zeros((len(inputs["observation"]), 0), np.float32)
    norm = tensors["normalizer.mean"], tensors["normalizer.scale"]
    chunk, _ = policy_chunk(
        "act", config, network(tensors, "act"), *norm, inputs["observation"], nothing, images
    )
    return np.asarray(chunk)


@pytest.fixture(scope="module", params=FORMATS, ids=str)
def blind(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Checkpoint, Path]:
    """A checkpoint with a state, of which one number never moved, and an environment; and its conversion."""
    processors, modes = request.param
    checkpoint = Checkpoint(environment=5, processors=processors, modes=modes)
    checkpoint.statistics[STATE]["max"][2] = checkpoint.statistics[STATE]["min"][2]
    folder = tmp_path_factory.mktemp("blind")
    convert(checkpoint.save(folder / "source"), folder / "policy.safetensors")
    return checkpoint, folder / "policy.safetensors"


@pytest.fixture(scope="module")
def seeing(tmp_path_factory: pytest.TempPathFactory) -> tuple[Checkpoint, Path]:
    """A checkpoint with a state and two cameras, and its conversion."""
    checkpoint = Checkpoint(cameras=CAMERAS)
    folder = tmp_path_factory.mktemp("seeing")
    convert(checkpoint.save(folder / "source"), folder / "policy.safetensors")
    return checkpoint, folder / "policy.safetensors"


def blind_batch(checkpoint: Checkpoint) -> dict[str, np.ndarray]:
    raw = batch(checkpoint)
    if checkpoint.modes["STATE"] == "MIN_MAX":  # LeRobot divides by 1e-8 there
        raw[STATE][:, 2] = checkpoint.statistics[STATE]["min"][2]
    return raw


def test_converted_policy_is_lerobots(blind: tuple[Checkpoint, Path]) -> None:
    checkpoint, file = blind
    raw = blind_batch(checkpoint)
    expected = checkpoint.forward(raw)
    assert expected.std(axis=0).max() > 0.01 and np.abs(expected).max() > 0.1
    np.testing.assert_allclose(jax_chunk(file, our_inputs(raw)), expected, rtol=0, atol=TOLERANCE)


def test_converted_policy_is_lerobots_in_the_runtime(blind: tuple[Checkpoint, Path]) -> None:
    checkpoint, file = blind
    raw = blind_batch(checkpoint)
    ours = runtime.run(file, our_inputs(raw))
    np.testing.assert_allclose(ours, checkpoint.forward(raw), rtol=0, atol=TOLERANCE)


def test_converted_policy_sees_what_lerobots_does(seeing: tuple[Checkpoint, Path]) -> None:
    checkpoint, file = seeing
    raw = batch(checkpoint)
    expected = checkpoint.forward(raw)
    first = {key: value[:1] for key, value in raw.items()}
    dark = checkpoint.forward(first | {"observation.images.wrist": 0 * first["observation.images.wrist"]})
    assert np.abs(expected[:1] - dark).max() > 0.01
    np.testing.assert_allclose(jax_chunk(file, our_inputs(raw)), expected, rtol=0, atol=TOLERANCE)
    assert [camera["name"] for camera in read_header(file).config["cameras"]] == ["top", "wrist"]


def test_converted_policy_sees_what_lerobots_does_in_the_runtime(seeing: tuple[Checkpoint, Path]) -> None:
    checkpoint, file = seeing
    raw = batch(checkpoint)
    ours = runtime.run(file, our_inputs(raw))
    np.testing.assert_allclose(ours, checkpoint.forward(raw), rtol=0, atol=TOLERANCE)


def test_bfloat16_stays_within_a_hundredth(tmp_path: Path) -> None:
    checkpoint = Checkpoint(environment=5)
    convert(checkpoint.save(tmp_path / "source"), tmp_path / "policy.safetensors", bfloat16=True)
    raw = batch(checkpoint)
    expected = checkpoint.forward(raw)
    error = np.abs(jax_chunk(tmp_path / "policy.safetensors", our_inputs(raw)) - expected).max()
    assert 1e-5 < error < 1e-2 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("settings", "execution"),
    [
        ({"n_action_steps": 3}, {"mode": "open_loop", "execute": 3, "ensemble_decay": 0.0}),
        (
            {"temporal_ensemble_coeff": 0.01, "n_action_steps": 1},
            {"mode": "temporal_ensembling", "execute": 1, "ensemble_decay": 0.01},
        ),
    ],
)
def test_execution_is_kept(tmp_path: Path, settings: dict[str, Any], execution: dict[str, Any]) -> None:
    checkpoint = Checkpoint()
    checkpoint.settings |= settings
    convert(checkpoint.save(tmp_path / "source"), tmp_path / "policy.safetensors")
    header = read_header(tmp_path / "policy.safetensors")
    assert header.execution.items() >= execution.items()
    assert header.observation == [f"state.{i}" for i in range(6)]


# ---- refusals

REFUSED = {
    "type": ("diffusion", "type is 'diffusion'; it must be 'act'"),
    "n_obs_steps": (2, "n_obs_steps is 2; it must be 1"),
    "pre_norm": (True, "pre_norm is True; it must be False"),
    "feedforward_activation": ("gelu", "feedforward_activation is 'gelu'; it must be 'relu'"),
    "vision_backbone": ("resnet34", "vision_backbone is 'resnet34'; it must be 'resnet18'"),
    "replace_final_stride_with_dilation": (True, "dilation is True; it must be False"),
    "use_peft": (True, "use_peft is True"),
    "n_heads": (5, "model_size is 24; it must be a multiple of heads = 5"),
    "chunk_size": (1000, "horizon: Input should be less than or equal to 256"),
    "dim_feedforward": (41, r"linear1.weight has shape \[40, 24\]; by config.json it must be \[41, 24\]"),
    "input_features": (None, "input_features or output_features with an action are missing"),
}


@pytest.fixture(scope="module")
def with_camera() -> Checkpoint:
    return Checkpoint(cameras={"observation.images.top": (24, 32)})


@pytest.mark.parametrize("setting", REFUSED)
def test_setting_that_can_not_be_followed_is_refused(
    tmp_path: Path, with_camera: Checkpoint, setting: str
) -> None:
    value, sentence = REFUSED[setting]
    folder = with_camera.save(tmp_path / "source")
    (folder / "config.json").write_text(json.dumps(with_camera.settings | {setting: value}))
    with pytest.raises(PolicyFileError, match=sentence):
        convert(folder, tmp_path / "policy.safetensors")
    assert not (tmp_path / "policy.safetensors").exists()


def refused(tmp_path: Path, checkpoint: Checkpoint, sentence: str) -> None:
    with pytest.raises(PolicyFileError, match=sentence):
        convert(checkpoint.save(tmp_path / "source"), tmp_path / "policy.safetensors")


def test_tensors_that_are_missing_or_unknown_are_refused(tmp_path: Path) -> None:
    checkpoint = Checkpoint()
    kept = checkpoint.tensors.pop("model.encoder.layers.1.norm2.bias")
    refused(tmp_path, checkpoint, r"model.encoder.layers.1.norm2.bias is missing")
    checkpoint.tensors |= {"model.encoder.layers.1.norm2.bias": kept, "model.extra.weight": kept}
    refused(tmp_path, checkpoint, r"model.extra.weight is unknown")


def test_statistics_that_are_missing_are_refused(tmp_path: Path) -> None:
    checkpoint = Checkpoint()
    del checkpoint.statistics[STATE]["std"]
    refused(tmp_path, checkpoint, r"the statistic std of observation.state is missing")


def test_statistics_that_were_never_filled_are_refused(tmp_path: Path) -> None:
    checkpoint = Checkpoint(processors=False)
    checkpoint.statistics["action"]["mean"][:] = np.inf
    refused(tmp_path, checkpoint, r"the statistic mean of action is not finite")


def test_unknown_normalisation_is_refused(tmp_path: Path) -> None:
    refused(
        tmp_path,
        Checkpoint(modes=MEAN_STD | {"STATE": "RANK"}),
        r"normalisation of STATE is 'RANK'; known are",
    )


def test_step_that_changes_numbers_is_refused(tmp_path: Path) -> None:
    checkpoint = Checkpoint()
    checkpoint.steps = [{"registry_name": "relative_actions_processor", "config": {}}]
    refused(tmp_path, checkpoint, r"policy_preprocessor.json: it has the step 'relative_actions_processor'")


def test_cameras_that_are_normalised_differently_are_refused(tmp_path: Path) -> None:
    checkpoint = Checkpoint(cameras=CAMERAS)
    checkpoint.statistics["observation.images.wrist"]["mean"][1] = 0.3
    refused(tmp_path, checkpoint, r"top and observation.images.wrist are normalised differently")


def test_policy_without_a_state_is_refused(tmp_path: Path) -> None:
    checkpoint = Checkpoint(cameras=CAMERAS)
    del checkpoint.settings["input_features"][STATE]
    refused(tmp_path, checkpoint, r"it has neither observation.state nor an environment state")


def test_folder_that_is_no_checkpoint_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PolicyFileError, match=r"config.json can't be read .* give the folder of a LeRobot"):
        convert(tmp_path, tmp_path / "policy.safetensors")
