"""Every head gives chunks of the right shape by the formulas that the policy runtime follows, too."""

from __future__ import annotations

import json
import math

import heads
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.signal import correlate2d

from tandem.learner.networks import HEADS, best_of_n, cameras, flow, image, read_config
from tandem.policy_file import named_arrays

N_OBS, A, H = 7, 2, 3
ALL = {
    "mlp": ("mlp", heads.mlp()),
    "gaussian": ("gaussian", heads.gaussian()),
    "flow": ("flow", heads.flow()),
    "flow transformer": ("flow", heads.flow_transformer()),
    "act": ("act", heads.act()),
    "act that draws": ("act", heads.act(sample_latent=True, output="tanh", activation="gelu")),
    "act that sees": ("act", heads.act(cameras=heads.CAMERAS, backbone=heads.CNN)),
    "best of n": (
        "best_of_n",
        heads.best_of_n([("flow", heads.flow(), 3), ("gaussian", heads.gaussian(), 2)], aggregate="min"),
    ),
    "grasp": ("grasp", heads.grasp("flow", heads.flow())),
}


@pytest.fixture(scope="module", params=ALL.values(), ids=ALL.keys())
def one(request):
    """Name, JSON and type of a head; its compiled function, parameters, inputs for 5 observations, chunks."""
    name, config = request.param
    typed, params = heads.network(name, config, N_OBS, A)
    inputs = heads.inputs(name, typed, 5, N_OBS, A)
    function = heads.jitted(HEADS[name].chunk)
    run = lambda params, *inputs: np.asarray(function(params, typed, *inputs))  # noqa: E731
    return name, config, typed, run, params, inputs, run(params, *inputs)


def test_config_is_the_json_of_the_policy_file(one):
    name, config, typed, *_ = one
    assert json.loads(typed.model_dump_json()) == config
    with pytest.raises(ValidationError):
        read_config(name, config | {"surprise": 1})
    with pytest.raises(ValidationError):
        read_config(name, config | {"horizon": "3"})


def test_chunk_has_its_shape_and_depends_on_every_parameter(one):
    name, _, typed, run, params, inputs, chunk = one
    assert chunk.shape == (5, H, A) and np.isfinite(chunk).all() and np.abs(chunk).max() > 0.05
    if name in ("best_of_n", "grasp"):
        return  # their critics only choose
    silent = []
    for path, array in named_arrays(params).items():
        kept = array.copy()
        array *= 1.1
        array += 0.1 * np.arange(array.size).reshape(array.shape) % 0.07
        if np.abs(run(params, *inputs) - chunk).max() < 1e-5:
            silent.append(path)
        array[...] = kept
    # a key's bias moves all scores of a softmax alike; ACT's first decoder layer attends to nothing but zeros
    silent = [path for path in silent if not path.endswith("key.bias")]
    unused = [
        f"decoder.0.self_attention.{part}"
        for part in ("query.weight", "query.bias", "key.weight", "value.weight")
    ]
    latent = [] if name == "act" and typed.sample_latent else ["latent.weight"]
    assert sorted(silent) == (sorted(unused + latent) if name == "act" else [])


def test_rows_of_a_batch_do_not_know_each_other(one):
    _, _, _, run, params, (x, noise, images), chunk = one
    others = np.arange(5)[:, None] != 2
    changed = {name: np.where(others[:, None, None], 255 - image, image) for name, image in images.items()}
    again = run(params, x + others, noise - others, changed)
    np.testing.assert_allclose(again[2], chunk[2], atol=2e-6)
    assert np.abs(again - chunk).max() > 1e-3


def test_noise_matters_when_there_is_any(one):
    _, _, _, run, params, (x, noise, images), chunk = one
    other = run(params, x, noise + np.float32(0.5), images)
    assert (np.abs(other - chunk).max() > 1e-3) == (noise.shape[1] > 0)


def test_tensors_of_act_have_the_names_of_the_file():
    config = heads.act(cameras=heads.CAMERAS, backbone={"kind": "resnet18", "width": 2}, encoder_layers=1)
    _, params = heads.network("act", config, N_OBS, A)
    names = {name: array.shape for name, array in named_arrays(params, "actor").items()}
    for name, shape in {
        "actor.latent.weight": (12, 5),
        "actor.tokens.1.weight": (12, 4),
        "actor.token_position": (3, 12),
        "actor.encoder.0.attention.query.weight": (12, 12),
        "actor.encoder.0.norm2.offset": (12,),
        "actor.decoder.1.cross_attention.output.bias": (12,),
        "actor.decoder.1.feedforward1.weight": (17, 12),
        "actor.decoder.1.norm3.scale": (12,),
        "actor.norm.scale": (12,),
        "actor.query_position": (3, 12),
        "actor.action.weight": (A, 12),
        "actor.output.scale": (A,),
        "actor.image.mean": (3,),
        "actor.camera_projection.weight": (12, 16),
        "actor.camera_position.wrist": (1, 12),
        "actor.backbone.conv1.weight": (2, 3, 7, 7),
        "actor.backbone.bn1.running_var": (2,),
        "actor.backbone.layer2.0.downsample.0.weight": (4, 2, 1, 1),
        "actor.backbone.layer2.0.downsample.1.running_mean": (4,),
        "actor.backbone.layer4.1.conv2.weight": (16, 16, 3, 3),
    }.items():
        assert names[name] == shape, name
    assert "actor.backbone.layer1.0.downsample.0.weight" not in names


def test_sizes_that_do_not_fit_are_refused_with_a_sentence():
    with pytest.raises(ValidationError, match="model_size is 13; it must be a multiple of heads = 3"):
        read_config("act", heads.act(model_size=13))
    with pytest.raises(ValidationError, match="cameras need a backbone"):
        read_config("act", heads.act(cameras=heads.CAMERAS))
    with pytest.raises(ValueError, match="sizes add up to 7; the observation has 8"):
        heads.network("act", heads.act(), 8, A)
    with pytest.raises(ValidationError, match=r"heads.0.config.horizon is 4; all heads have 3"):
        read_config("best_of_n", heads.best_of_n([("mlp", heads.mlp(horizon=4), 1)]))


def test_gaussian_without_noise_is_its_mean_and_bounds_its_deviation():
    typed, params = heads.network("gaussian", heads.gaussian(log_std_max=-1.0), N_OBS, A)
    x, noise, _ = heads.inputs("gaussian", typed, 4, N_OBS, A)
    last = params["layers"][-1]
    last["bias"][: H * A], last["bias"][H * A :], last["weight"][:] = 0.2, 50.0, 0.0
    chunk = heads.jitted(HEADS["gaussian"].chunk)
    np.testing.assert_allclose(chunk(params, typed, x, 0 * noise, {}), math.tanh(0.2), rtol=1e-6)
    expected = np.tanh(0.2 + math.exp(-1.0) * noise).reshape(4, H, A)
    np.testing.assert_allclose(chunk(params, typed, x, noise, {}), expected, atol=1e-6)


@pytest.mark.parametrize("config", [heads.flow(), heads.flow_transformer()], ids=["mlp", "transformer"])
def test_flow_walks_from_the_noise_and_clips_only_the_end(config):
    typed, params = heads.network("flow", config, N_OBS, A)
    x, noise, _ = heads.inputs("flow", typed, 4, N_OBS, A)
    last = params["output"] if "output" in params else params["layers"][-1]
    last["weight"][:], last["bias"][:] = 0.0, 0.75
    chunk = heads.jitted(flow.chunk)(params, typed, x, noise, {})
    np.testing.assert_allclose(chunk, np.clip(noise + 0.75, -1, 1).reshape(4, H, A), atol=1e-6)


def test_flow_takes_euler_steps_along_its_field():
    typed, params = heads.network("flow", heads.flow(layer_norm=False, activation="tanh"), N_OBS, A)
    x, noise, _ = heads.inputs("flow", typed, 4, N_OBS, A)
    a = noise
    for k in range(4):
        phi = [math.cos(math.pi * i * k / 4) for i in (1, 2, 3)] + [
            math.sin(math.pi * i * k / 4) for i in (1, 2, 3)
        ]
        y = np.concatenate([x, a, np.tile(phi, (4, 1))], axis=1)
        for index, layer in enumerate(params["layers"]):
            y = y @ layer["weight"].T + layer["bias"]
            y = np.tanh(y) if index < 2 else y
        a = a + y / 4
    chunk = heads.jitted(flow.chunk)(params, typed, x, noise, {})
    np.testing.assert_allclose(chunk, np.clip(a, -1, 1).reshape(4, H, A), atol=2e-6)


# ---- best of n


def test_candidates_are_the_samples_head_after_head_then_their_edits():
    config = heads.best_of_n(
        [("gaussian", heads.gaussian(), 2), ("mlp", heads.mlp(), 1), ("flow", heads.flow(), 2)]
    )
    typed, params = heads.network("best_of_n", config, N_OBS, A)
    x, noise, _ = heads.inputs("best_of_n", typed, 4, N_OBS, A)
    n = H * A
    assert noise.shape == (4, 4 * n + 5 * n)
    proposed = heads.jitted(best_of_n.candidates)(params, typed, x, noise, {})
    assert proposed.shape == (4, 10, H, A)
    nothing = np.zeros((4, 0), np.float32)
    drawn = [noise[:, begin : begin + n] for begin in range(0, 4 * n, n)]
    samples = [(0, drawn[0]), (0, drawn[1]), (1, nothing), (2, drawn[2]), (2, drawn[3])]
    for index, (architecture, own) in enumerate(samples):
        part = typed.heads[architecture]
        expected = heads.jitted(part.head.chunk)(params["actor"][architecture], part.config, x, own, {})
        np.testing.assert_allclose(proposed[:, index], expected, atol=2e-6)
    edit = heads.jitted(best_of_n.edit)
    edited = edit(params["edit"], typed.edit, x, proposed[:, 3:4], noise[:, 7 * n : 8 * n])
    np.testing.assert_allclose(proposed[:, 8], edited[:, 0], atol=2e-6)
    assert 1e-3 < np.abs(proposed[:, 5:] - proposed[:, :5]).max() <= 0.05 + 1e-6


@pytest.mark.parametrize(("aggregate", "expected"), [("mean", 1.0), ("min", -2.0)])
def test_score_is_the_mean_or_the_minimum_of_the_critics(aggregate, expected):
    config = heads.best_of_n([("mlp", heads.mlp(), 1)], aggregate=aggregate)
    typed, params = heads.network("best_of_n", config, N_OBS, A)
    for member, value in zip(params["critic"], (4.0, -2.0, 1.0), strict=True):
        last = member["layers"][-1]
        last["weight"][:], last["bias"][:] = 0.0, value
    stacked = best_of_n.stacked(params["critic"])
    x, proposed = np.zeros((2, N_OBS), np.float32), np.zeros((2, 4, H, A), np.float32)
    score = heads.jitted(best_of_n.scores)(stacked, typed.critic, x, proposed)
    np.testing.assert_allclose(score, np.full((2, 4), expected))


def test_winner_is_the_first_of_the_highest_and_always_finite():
    proposed = jnp.arange(4.0)[None, :, None, None] * jnp.ones((1, 4, H, A))
    inf, nan = math.inf, math.nan

    def winner(*scores):
        return float(best_of_n.choose(jnp.array([scores]), proposed)[0, 0, 0])

    assert winner(0.0, 2.0, 2.0, 1.0) == 1
    assert winner(-3.0, nan, inf, -4.0) == 0
    assert math.isnan(winner(nan, -inf, inf, nan))


def test_heads_that_share_a_camera_see_the_same_images():
    seeing = heads.act(cameras=heads.CAMERAS[:1], backbone=heads.CNN)
    typed = read_config("best_of_n", heads.best_of_n([("act", seeing, 1), ("act", seeing, 1)]))
    assert [camera.name for camera in cameras(typed)] == ["top"]


# ---- images


def test_cnn_is_convolution_bias_and_relu():
    typed, params = heads.network("act", heads.act(cameras=heads.CAMERAS, backbone=heads.CNN), N_OBS, A)
    _, _, images = heads.inputs("act", typed, 1, N_OBS, A)
    pixels = jax.jit(image.normalise_pixels)(params["image"], images["top"])
    mean, scale = (np.asarray(params["image"][name], np.float64) for name in ("mean", "scale"))
    expected = (np.asarray(images["top"][0], np.float64) / 255 - mean) * scale
    np.testing.assert_allclose(pixels[0], expected, atol=1e-5)
    x = expected.transpose(2, 0, 1)
    for layer, weights in zip(heads.CNN["layers"], params["backbone"], strict=True):
        margin, step = layer["kernel"] // 2, layer["stride"]
        padded = np.pad(x, ((0, 0), (margin, margin), (margin, margin)))
        filters = np.asarray(weights["weight"], np.float64)
        full = [sum(correlate2d(c, f, "valid") for c, f in zip(padded, one, strict=True)) for one in filters]
        x = np.maximum(np.stack(full)[:, ::step, ::step] + np.asarray(weights["bias"])[:, None, None], 0)
    features = heads.jitted(image.features)(params["backbone"], typed.backbone, pixels)
    assert features.shape[1:3] == image.feature_size(typed.backbone, typed.cameras[0]) == x.shape[1:]
    np.testing.assert_allclose(np.asarray(features[0]).transpose(2, 0, 1), x, atol=1e-5)


@pytest.mark.parametrize(("height", "width"), [(24, 31), (64, 33), (97, 128)])
def test_size_of_resnet_features_is_known_before_there_are_any(height, width):
    backbone = image.ResNet18(width=2)
    params = image.init_backbone(np.random.default_rng(0), backbone)
    shape = jax.eval_shape(
        lambda x: image.features(params, backbone, x), jnp.zeros((1, height, width, 3))
    ).shape
    camera = image.Camera(name="c", height=height, width=width)
    assert shape == (1, *image.feature_size(backbone, camera), backbone.channels)


def test_positions_of_pixels_are_acts_sines():
    table = image.sine_positions(3, 5, 8)
    assert table.shape == (15, 8)
    row, column = 1, 3
    y, x = (row + 1) / 3 * 2 * math.pi, (column + 1) / 5 * 2 * math.pi
    long = 10_000 ** (2 / 4)
    expected = [f(angle / w) for angle in (y, x) for w in (1, long) for f in (math.sin, math.cos)]
    np.testing.assert_allclose(table[row * 5 + column], expected, atol=1e-5)
