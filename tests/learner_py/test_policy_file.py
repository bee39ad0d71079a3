"""The policy file: what the arm computes from it is what the trainer deployed, byte for byte and number for number."""

from __future__ import annotations

import heads
import ml_dtypes
import numpy as np
import pytest
import support
from safetensors import safe_open

from tandem.learner.golden import golden_examples
from tandem.learner.networks import HEADS
from tandem.learner.normalizer import Normalizer
from tandem.learner.trainer import Trainer
from tandem.policy_file import (
    PolicyFileError,
    PolicyHeader,
    encode_safetensors,
    named_arrays,
    read_header,
    read_safetensors,
    rounded,
    write_file,
    write_policy,
)


def trained(**facts) -> Trainer:
    trainer = Trainer(support.scenario(**facts), git_revision="abc")
    for number in range(2):
        episode = support.demonstration(number)
        trainer.ingest(episode)
        trainer.train(episode, lambda report: True)
    return trainer


def numpy_forward(tensors, config, observation):
    """The contract's network, written anew."""
    x = (observation - tensors["normalizer.mean"]) * tensors["normalizer.scale"]
    n = len(config["hidden"])
    for i in range(n + 1):
        y = x @ tensors[f"actor.layers.{i}.weight"].T + tensors[f"actor.layers.{i}.bias"]
        if i == n:
            return np.tanh(y).reshape(len(x), config["horizon"], -1)
        if config["layer_norm"]:
            y = (y - y.mean(1, keepdims=True)) / np.sqrt(y.var(1, keepdims=True) + 1e-6)
            y = y * tensors[f"actor.layers.{i}.norm_scale"] + tensors[f"actor.layers.{i}.norm_offset"]
        gelu = 0.5 * y * (1 + np.tanh(np.sqrt(2 / np.pi) * (y + 0.044715 * y**3)))
        x = {"relu": np.maximum(y, 0), "tanh": np.tanh(y), "gelu": gelu}[config["activation"]]


@pytest.mark.parametrize(
    "facts",
    [
        {},
        {
            "method": "mlp_qchunk_mcbc",
            "head": {"mlp": {"hidden": [16, 24], "activation": "tanh", "layer_norm": True}},
        },
        {"head": {"mlp": {"activation": "gelu"}}},
    ],
)
def test_golden_examples_agree_with_an_independent_forward_pass(tmp_path, facts):
    trainer = trained(warm_start_updates=0, **facts)
    rng = np.random.default_rng(0)  # no number may be special, biases and norms included
    layers = [
        {k: v + 0.3 * rng.normal(size=v.shape).astype("f") for k, v in layer.items()}
        for layer in trainer.state.average["actor"]["layers"]
    ]
    average = trainer.state.average | {"actor": {"layers": layers}}
    trainer.state = trainer.state._replace(average=average)
    trainer.write_policy(tmp_path / "policy.safetensors")
    tensors, _ = read_safetensors(tmp_path / "policy.safetensors")
    header = read_header(tmp_path / "policy.safetensors")
    assert len(tensors["golden.observation"]) >= 8
    horizon, axes = trainer.scenario.method.horizon, len(trainer.scenario.task.action_axes)
    assert tensors["golden.chunk"].shape[1:] == (horizon, axes)
    ours = numpy_forward(tensors, header.config, tensors["golden.observation"])
    assert np.abs(ours - tensors["golden.chunk"]).max() < 2e-6
    assert np.abs(tensors["golden.chunk"]).max() > 0.01


def test_file_is_what_the_library_reads_with_all_metadata(tmp_path):
    trained().write_policy(tmp_path / "policy.safetensors")
    with safe_open(str(tmp_path / "policy.safetensors"), "np") as file:
        metadata = file.metadata()
        assert {str(file.get_tensor(name).dtype) for name in list(file.keys())} == {"float32"}
        assert file.get_tensor("actor.layers.0.weight").shape == (16, 3)
    assert metadata["format"] == "tandem-policy-1" and metadata["architecture"] == "mlp"
    assert metadata["action"] == '["x", "rz", "gripper"]' and metadata["episodes_trained_through"] == "1"
    assert set(metadata) == {
        "format", "architecture", "config", "observation", "action", "task", "method", "execution", "discount",
        "version", "env_steps", "updates", "episodes_trained_through", "git_revision",
    }  # fmt: skip
    header = read_header(tmp_path / "policy.safetensors")
    assert header.version == 1 and header.updates == 70 and header.execution["mode"] == "temporal_ensembling"


def test_same_policy_gives_the_same_bytes(tmp_path):
    first = trained().write_policy(tmp_path / "a")
    second = trained().write_policy(tmp_path / "b")
    assert first.sha256 == second.sha256 and first.n_bytes == (tmp_path / "a").stat().st_size


def test_diverged_policy_is_never_written(tmp_path):
    trainer = trained()
    trainer.normalizer = Normalizer(np.full(3, np.nan, np.float32), np.ones(3, np.float32))
    with pytest.raises(PolicyFileError, match=r"normalizer.mean holds a number that is not finite"):
        trainer.write_policy(tmp_path / "policy.safetensors")
    assert not list(tmp_path.iterdir())


def test_reader_refuses_what_is_no_policy_with_a_sentence(tmp_path):
    path = tmp_path / "x"
    for data in (b"", b"\xff" * 30, encode_safetensors({"a": np.zeros(2, np.float32)}, {"format": "other"})):
        write_file(path, data)
        with pytest.raises(PolicyFileError, match=r"is not a|can't be read"):
            read_header(path)


def test_constant_inputs_do_not_blow_up():
    moving = np.linspace(0, 1, 50)
    observation = np.stack([moving, np.full(50, 0.3), 1e-5 * moving], 1).astype(np.float32)
    normalizer = Normalizer.fit([observation[:20], observation[20:]], floor=1e-3)
    np.testing.assert_allclose(normalizer.scale, [1 / moving.std(), 1e3, 1e3], rtol=1e-5)
    np.testing.assert_allclose(normalizer.apply(observation)[:, 0].std(), 1.0, rtol=1e-5)
    assert np.abs(normalizer.apply(observation + np.float32(0.01))[:, 1:]).max() < 11


# ---- any architecture


def header(architecture, config):
    return PolicyHeader(
        architecture=architecture, config=config, observation=list("abcdefg"), action=["x", "y"], task="peg",
        method="test", execution={"mode": "receding"}, discount=0.98, version=1, env_steps=0, updates=0,
        episodes_trained_through=-1, git_revision="test",
    )  # fmt: skip


def written(path, architecture, config, bfloat16=False, **changes):
    """A file of a random network, and the network."""
    typed, params = heads.network(architecture, config, 7, 2)
    params = rounded(params) if bfloat16 else params
    mean, scale = np.full(7, 0.5, np.float32), np.full(7, 2.0, np.float32)
    golden = golden_examples(architecture, typed, params, 2, mean, scale, np.random.default_rng(0)) | changes
    write_policy(path, header(architecture, config), params, mean, scale, golden, bfloat16)
    return typed, params


SEEING = heads.act(cameras=heads.CAMERAS, backbone=heads.CNN, sample_latent=True)


def test_golden_examples_hold_every_input_and_their_chunk(tmp_path):
    typed, params = written(tmp_path / "p", "act", SEEING)
    tensors, _ = read_safetensors(tmp_path / "p")
    assert tensors["golden.image.top"].shape == (8, 24, 31, 3)
    assert tensors["golden.image.wrist"].dtype == np.uint8
    assert tensors["golden.noise"].shape == (8, 5) and tensors["golden.observation"].shape == (8, 7)
    x = (tensors["golden.observation"] - tensors["normalizer.mean"]) * tensors["normalizer.scale"]
    assert 1 < np.abs(x).max() <= 3.001
    images = {name: tensors[f"golden.image.{name}"] for name in ("top", "wrist")}
    chunk = heads.jitted(HEADS["act"].chunk)(params, typed, x, tensors["golden.noise"], images)
    np.testing.assert_allclose(chunk, tensors["golden.chunk"], atol=2e-6)
    assert {name for name in tensors if name.startswith("actor.")} == set(named_arrays(params, "actor"))
    assert read_header(tmp_path / "p").config == SEEING


def test_parts_of_a_best_of_n_have_names_of_their_own(tmp_path):
    written(
        tmp_path / "p", "best_of_n", heads.best_of_n([("flow", heads.flow(), 2), ("mlp", heads.mlp(), 1)])
    )
    tensors, _ = read_safetensors(tmp_path / "p")
    assert {name.rpartition(".layers")[0] for name in tensors if ".layers" in name} == {
        "actor.0", "actor.1", "edit", "critic.0", "critic.1", "critic.2",
    }  # fmt: skip
    assert tensors["critic.2.layers.0.weight"].shape == (11, 7 + 6)


def test_bfloat16_file_holds_what_its_golden_examples_computed(tmp_path):
    _, params = written(tmp_path / "p", "act", SEEING, bfloat16=True)
    tensors, _ = read_safetensors(tmp_path / "p")
    narrow = {name for name, array in tensors.items() if array.dtype == ml_dtypes.bfloat16}
    named = named_arrays(params, "actor")
    assert narrow == {name for name, array in named.items() if name.endswith(".weight") and array.ndim == 2}
    for name in narrow:
        np.testing.assert_array_equal(tensors[name].astype(np.float32), named[name])
    assert {tensors[name].dtype for name in named.keys() - narrow} == {np.dtype(np.float32)}
    with safe_open(str(tmp_path / "p"), "np") as file:
        assert file.get_slice("actor.action.weight").get_dtype() == "BF16"
        assert file.get_slice("golden.image.top").get_dtype() == "U8"


def test_rounding_changes_matrices_a_little_and_nothing_else():
    _, params = heads.network("act", SEEING, 7, 2)
    before, after = named_arrays(params), named_arrays(rounded(params))
    assert list(before) == list(after)
    for name, array in before.items():
        difference = np.abs(after[name] - array).max() / np.abs(array).max()
        assert (0 < difference < 2**-8) == (name.endswith(".weight") and array.ndim == 2), name


def test_number_that_is_not_finite_is_refused_wherever_it_stands(tmp_path):
    noise = np.zeros((8, 5), np.float32)
    noise[3, 2] = np.inf
    with pytest.raises(PolicyFileError, match=r"golden.noise holds a number that is not finite"):
        written(tmp_path / "p", "act", SEEING, noise=noise)
    assert not (tmp_path / "p").exists()
