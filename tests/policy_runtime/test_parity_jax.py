"""The C++ runtime computes what the learner's own networks compute in JAX: at most 1e-5 apart, whatever their sizes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import heads
import numpy as np
import pytest
import runtime

from tandem.learner.golden import CLEAR, golden_examples, policy_chunk
from tandem.learner.noise import seeded_noise
from tandem.policy_file import rounded, write_policy

TOLERANCE = 1e-5  # action units
BFLOAT16_TOLERANCE = 1e-2  # of the largest action, against the network before its weights were rounded
KERNELS = ["", "scalar"]  # the best of this machine, and the reference

Json = dict[str, Any]


def tokens(*sizes: int) -> list[Json]:
    return [{"name": f"token_{i}", "size": size} for i, size in enumerate(sizes)]


def mlp(hidden: list[int], horizon: int, activation: str, layer_norm: bool) -> Json:
    return heads.mlp(hidden=hidden, horizon=horizon, activation=activation, layer_norm=layer_norm)


CAMERAS = [{"name": "top", "height": 24, "width": 31}, {"name": "wrist", "height": 17, "width": 16}]
CNN = {
    "kind": "cnn",
    "layers": [
        {"channels": 9, "kernel": 5, "stride": 3},
        {"channels": 17, "kernel": 3, "stride": 1},
        {"channels": 5, "kernel": 1, "stride": 2},
        {"channels": 31, "kernel": 3, "stride": 2},
    ],
}
LARGER = [{"name": "front", "height": 47, "width": 65}]
RESNET_8, RESNET_64 = ({"kind": "resnet18", "width": width} for width in (8, 64))
# sizes that fill no vector of any machine, and some that do
SMALL = {
    "model_size": 15,
    "heads": 5,
    "feedforward": 7,
    "encoder_layers": 1,
    "decoder_layers": 1,
    "horizon": 1,
}
MIDDLE = {
    "model_size": 36,
    "heads": 3,
    "feedforward": 65,
    "encoder_layers": 2,
    "decoder_layers": 2,
    "horizon": 9,
}
LARGE = {
    "model_size": 64,
    "heads": 4,
    "feedforward": 129,
    "encoder_layers": 3,
    "decoder_layers": 1,
    "horizon": 33,
}

# name: architecture, config, observation, axes
NETWORKS: dict[str, tuple[str, Json, int, int]] = {
    "mlp of one layer": ("mlp", mlp([], 1, "relu", False), 1, 1),
    "mlp 256": ("mlp", mlp([256, 256], 1, "relu", False), 26, 4),
    "mlp 256 normalised": ("mlp", mlp([256, 256], 1, "relu", True), 26, 4),
    "mlp 1 33": ("mlp", mlp([1, 33], 2, "tanh", False), 13, 3),
    "mlp 17": ("mlp", mlp([17], 3, "gelu", False), 31, 5),
    "mlp 256 three times": ("mlp", mlp([256, 256, 256], 8, "gelu", True), 40, 7),
    "mlp 127 65 7": ("mlp", mlp([127, 65, 7], 7, "tanh", True), 19, 2),
    "mlp 63 100": ("mlp", mlp([63, 100], 4, "relu", True), 64, 6),
    "mlp 300 5": ("mlp", mlp([300, 5], 5, "gelu", True), 3, 7),
    "gaussian of one layer": ("gaussian", heads.gaussian(hidden=[], layer_norm=False, horizon=1), 5, 1),
    "gaussian 33": ("gaussian", heads.gaussian(hidden=[33, 15], activation="tanh", horizon=4), 17, 3),
    "gaussian bounded": ("gaussian", heads.gaussian(log_std_min=-0.5, log_std_max=-0.25, horizon=2), 9, 7),
    "flow of one step": ("flow", heads.flow(hidden=[1], layer_norm=False, steps=1, time_features=2, horizon=1), 1, 1),
    "flow 65": ("flow", heads.flow(hidden=[65, 31], activation="tanh", steps=7, time_features=10, horizon=5), 23, 3),
    "flow 128": ("flow", heads.flow(hidden=[128, 128], activation="relu", steps=8, time_features=16, horizon=4), 40, 7),
    "flow attends, small": (
        "flow",
        heads.flow_transformer(**SMALL, steps=1, time_features=2, tokens=tokens(3)),
        3,
        1,
    ),
    "flow attends": (
        "flow",
        heads.flow_transformer(**MIDDLE, steps=5, time_features=6, activation="gelu", tokens=tokens(1, 17, 5)),
        23,
        7,
    ),
    "act small": ("act", heads.act(**SMALL, tokens=tokens(3), latent_size=1), 3, 1),
    "act middle": (
        "act",
        heads.act(**MIDDLE, tokens=tokens(14, 1, 18), activation="gelu", output="tanh", latent_size=5),
        33,
        7,
    ),
    "act large, draws": ("act", heads.act(**LARGE, tokens=tokens(40), sample_latent=True, latent_size=32), 40, 14),
    "act sees": ("act", heads.act(**MIDDLE, tokens=tokens(6), cameras=CAMERAS, backbone=CNN), 6, 4),
    "act sees, resnet 8": (
        "act",
        heads.act(**SMALL | {"model_size": 20}, tokens=tokens(6), cameras=LARGER, backbone=RESNET_8),
        6,
        4,
    ),
    "act sees, resnet 64": (
        "act",
        heads.act(**SMALL | {"model_size": 20}, tokens=tokens(6), cameras=CAMERAS[:1], backbone=RESNET_64),
        6,
        4,
    ),
    "best of 9 gaussians": (
        "best_of_n",
        heads.best_of_n([("gaussian", heads.gaussian(), 9)], edit=False, members=1),
        7,
        3,
    ),
    "best of 8 flows, edited": (
        "best_of_n",
        heads.best_of_n([("flow", heads.flow(), 8)], members=5, hidden=[33, 17], aggregate="min"),
        26,
        7,
    ),
    "grasp, gaussian arm": ("grasp", heads.grasp("gaussian", heads.gaussian(), hidden=[33, 17]), 26, 5),
    "grasp, flow arm": ("grasp", heads.grasp("flow", heads.flow(), activation="tanh", layer_norm=False), 7, 2),
    "encoded grasp": (
        "encoded",
        heads.encoded("grasp", heads.grasp("gaussian", heads.gaussian()), CAMERAS[:1], CNN, features=16),
        7,
        3,
    ),
    "encoded mlp": ("encoded", heads.encoded("mlp", heads.mlp(), CAMERAS, CNN, features=5), 6, 4),
    "encoded flow": (
        "encoded",
        heads.encoded("flow", heads.flow(hidden=[33, 17]), CAMERAS[:1], CNN, features=33),
        18,
        4,
    ),
    "encoded best of 8 flows, edited": (
        "encoded",
        heads.encoded("best_of_n", heads.best_of_n([("flow", heads.flow(), 8)]), CAMERAS[1:], CNN, features=16),
        7,
        3,
    ),
    "best of all kinds": (
        "best_of_n",
        heads.best_of_n(
            [
                ("mlp", heads.mlp(), 1),
                ("flow", heads.flow_transformer(tokens=tokens(3, 4), decoder_layers=1), 2),
                ("gaussian", heads.gaussian(), 3),
                ("act", heads.act(tokens=tokens(7), sample_latent=True, output="tanh", encoder_layers=1), 2),
            ],
            members=2,
            activation="gelu",
            layer_norm=False,
        ),
        7,
        2,
    ),
}  # fmt: skip
BFLOAT16 = [
    "mlp 127 65 7",
    "gaussian 33",
    "flow 65",
    "flow attends",
    "act middle",
    "act sees",
    "best of 8 flows, edited",
    "encoded flow",
]


@dataclass(frozen=True)
class Written:
    """A policy file, and what JAX computes for new inputs."""

    file: Path
    architecture: str
    config: Any
    params: Any  # as written: rounded, where the file holds bfloat16
    exact: Any  # before
    mean: np.ndarray
    scale: np.ndarray
    fresh: dict[str, np.ndarray]  # observation, noise, image.CAMERA, chunk

    @property
    def inputs(self) -> dict[str, np.ndarray]:
        return {name: array for name, array in self.fresh.items() if name != "chunk"}

    def chunk(self, params: Any, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Chunks of the fresh inputs by other parameters or noise, and which have a clear winner."""
        images = {name[6:]: array for name, array in self.fresh.items() if name.startswith("image.")}
        norm = self.mean, self.scale
        both = policy_chunk(
            self.architecture, self.config, params, *norm, self.fresh["observation"], noise, images
        )
        return np.asarray(both[0]), np.asarray(both[1]) >= CLEAR


def write(folder: Path, name: str, bfloat16: bool = False) -> Written:
    architecture, config, n_observation, n_axes = NETWORKS[name]
    typed, exact = heads.network(architecture, config, n_observation, n_axes)
    params = rounded(exact) if bfloat16 else exact
    generator = np.random.default_rng(7)
    mean = generator.normal(0.0, 1.0, n_observation).astype(np.float32)
    scale = generator.uniform(0.3, 3.0, n_observation).astype(np.float32)
    network = (architecture, typed, params, n_axes, mean, scale)
    golden, fresh = (golden_examples(*network, np.random.default_rng(seed)) for seed in (0, 1))
    header = runtime.header(architecture, config, n_observation, n_axes)
    write_policy(folder / "policy.safetensors", header, params, mean, scale, golden, bfloat16)
    return Written(folder / "policy.safetensors", architecture, typed, params, exact, mean, scale, fresh)


@pytest.fixture(scope="module", params=NETWORKS)
def written(request: Any, tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write(tmp_path_factory.mktemp("policy"), request.param)


@pytest.fixture(scope="module", params=BFLOAT16)
def narrow(request: Any, tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write(tmp_path_factory.mktemp("policy"), request.param, bfloat16=True)


def check(written: Written, kernel: str) -> np.ndarray:
    ours = runtime.run(written.file, written.inputs, kernel)
    theirs = written.fresh["chunk"]
    assert ours.shape == theirs.shape
    assert np.abs(theirs).max() > 0.1, "the network is too tame to test anything"
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=TOLERANCE)
    return ours


@pytest.mark.parametrize("kernel", KERNELS, ids=["best", "scalar"])
def test_chunks_agree_with_jax(written: Written, kernel: str) -> None:
    check(written, kernel)
    facts = runtime.info(written.file, kernel)
    assert facts["golden_error"] <= TOLERANCE
    assert facts["horizon"] == written.config.horizon and facts["architecture"] == written.architecture


@pytest.mark.parametrize("kernel", KERNELS, ids=["best", "scalar"])
def test_chunks_of_bfloat16_weights_agree_with_jax(narrow: Written, kernel: str) -> None:
    ours = check(narrow, kernel)
    if narrow.architecture == "best_of_n":
        return  # rounding may choose another winner
    noise = narrow.fresh.get("noise", np.zeros((len(ours), 0), np.float32))
    exact, _ = narrow.chunk(narrow.exact, noise)
    error = np.abs(ours - exact).max()
    assert 0.0 < error <= BFLOAT16_TOLERANCE * np.abs(exact).max()


def test_sampler_draws_what_the_learner_draws(written: Written) -> None:
    """Without noise in the input, row n takes the noise of seed n."""
    if "noise" not in written.fresh:
        return
    noise = np.stack([seeded_noise(row, array.size) for row, array in enumerate(written.fresh["noise"])])
    theirs, clear = written.chunk(written.params, noise)
    assert clear.sum() >= 4 and np.abs(theirs - written.fresh["chunk"]).max() > 1e-3
    inputs = {name: array for name, array in written.inputs.items() if name != "noise"}
    ours = runtime.run(written.file, inputs)
    np.testing.assert_allclose(ours[clear], theirs[clear], rtol=0.0, atol=TOLERANCE)


@pytest.mark.parametrize(
    ("spread", "slope"), [(1e-3, 1.0), (1e-5, 1.0), (1e-7, 1.0), (1.0, 1e-6), (1.0, 0.0)]
)
def test_policy_whose_critic_can_hardly_choose_is_accepted(
    tmp_path: Path, spread: float, slope: float
) -> None:
    """A flow that gives nearly one chunk whatever the noise, or a critic that is nearly flat."""
    flow = heads.flow(hidden=[], layer_norm=False, steps=1, time_features=2)
    config = heads.best_of_n([("flow", flow, 8)], edit=slope == 0.0)
    typed, params = heads.network("best_of_n", config, 5, 2)
    last = params["actor"][0]["layers"][-1]
    last["weight"][:], last["bias"][:] = 0.0, 0.3
    last["weight"][:, 5:11] = (spread - 1.0) * np.eye(6)
    for member in params["critic"]:
        member["layers"][-1]["weight"] *= np.float32(slope)
    zeros, ones = np.zeros(5, np.float32), np.ones(5, np.float32)
    golden = golden_examples("best_of_n", typed, params, 2, zeros, ones, np.random.default_rng(0))
    policy = tmp_path / "policy.safetensors"
    write_policy(policy, runtime.header("best_of_n", config, 5, 2), params, zeros, ones, golden)
    for kernel in KERNELS:
        assert runtime.info(policy, kernel)["golden_error"] <= TOLERANCE


def test_a_wrong_golden_example_is_refused_with_a_sentence(tmp_path: Path) -> None:
    typed, params = heads.network("mlp", heads.mlp(), 5, 2)
    zeros, ones = np.zeros(5, np.float32), np.ones(5, np.float32)
    golden = golden_examples("mlp", typed, params, 2, zeros, ones, np.random.default_rng(0))
    golden["chunk"] = golden["chunk"] + np.float32(1e-3)
    policy = tmp_path / "policy.safetensors"
    write_policy(policy, runtime.header("mlp", heads.mlp(), 5, 2), params, zeros, ones, golden)
    result = runtime.program("info", policy)
    assert result.returncode == 2
    assert "golden examples differ by 0.001" in result.stderr
    assert str(policy) in result.stderr
