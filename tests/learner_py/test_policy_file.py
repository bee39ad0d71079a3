"""The policy file: what the arm computes from it is what the trainer deployed, byte for byte and number for number."""

from __future__ import annotations

import numpy as np
import pytest
import support
from safetensors import safe_open

from tandem.learner.normalizer import Normalizer
from tandem.learner.trainer import Trainer
from tandem.policy_file import PolicyFileError, encode_safetensors, read_header, read_safetensors, write_file


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
        {"method": "mlp_qchunk_mcbc", "head": {"hidden": [16, 24], "activation": "tanh", "layer_norm": True}},
        {"head": {"activation": "gelu"}},
    ],
)
def test_golden_examples_agree_with_an_independent_forward_pass(tmp_path, facts):
    trainer = trained(warm_start_updates=0, **facts)
    rng = np.random.default_rng(0)  # no number may be special, biases and norms included
    actor = [
        {k: v + 0.3 * rng.normal(size=v.shape).astype("f") for k, v in layer.items()}
        for layer in trainer.state.actor
    ]
    trainer.state = trainer.state._replace(actor_average=actor)
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
    assert header.version == 1 and header.updates == 70 and header.execution["mode"] == "receding"


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
