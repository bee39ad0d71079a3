"""Camera images -> feature vectors: normalised pixels through a ResNet-18 or a plain CNN.

Images and features are (B, H, W, C); convolution weights are (out, in, kh, kw) as in the policy file. The ResNet's
tensors have torchvision's names; its batch norms are frozen: they use their running statistics.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from pydantic import Field

from tandem.learner.networks.base import Array, HeadConfig, Params, array, ones, zeros

BATCH_NORM_EPSILON = 1e-5
IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class Camera(HeadConfig):
    name: Annotated[str, Field(min_length=1)]
    height: Annotated[int, Field(ge=8, le=1024)]
    width: Annotated[int, Field(ge=8, le=1024)]


class ResNet18(HeadConfig):
    kind: Literal["resnet18"] = "resnet18"
    width: Annotated[int, Field(ge=1, le=256)]  # channels of the first stage; torchvision's has 64

    @property
    def channels(self) -> int:
        return 8 * self.width


class Convolution(HeadConfig):
    channels: Annotated[int, Field(ge=1, le=2048)]
    kernel: Literal[1, 3, 5, 7]
    stride: Annotated[int, Field(ge=1, le=4)]


class Cnn(HeadConfig):
    """Convolution (padding kernel // 2), bias, relu; layer after layer."""

    kind: Literal["cnn"] = "cnn"
    layers: Annotated[tuple[Convolution, ...], Field(min_length=1, max_length=16, strict=False)]

    @property
    def channels(self) -> int:
        return self.layers[-1].channels


Backbone = Annotated[ResNet18 | Cnn, Field(discriminator="kind")]


# ---- start values


def init_pixels() -> Params:
    return {"mean": array(IMAGENET_MEAN), "scale": array(1.0 / np.array(IMAGENET_DEVIATION))}


def _init_convolution(generator: np.random.Generator, n_in: int, n_out: int, kernel: int) -> Array:
    deviation = (2.0 / (n_in * kernel * kernel)) ** 0.5
    return array(deviation * generator.standard_normal((n_out, n_in, kernel, kernel)))


def _init_batch_norm(channels: int) -> Params:
    return {
        "weight": ones(channels),
        "bias": zeros(channels),
        "running_mean": zeros(channels),
        "running_var": ones(channels),
    }


def init_backbone(generator: np.random.Generator, backbone: Any) -> Params:
    if isinstance(backbone, Cnn):
        n_in, layers = 3, []
        for layer in backbone.layers:
            weight = _init_convolution(generator, n_in, layer.channels, layer.kernel)
            layers.append({"weight": weight, "bias": zeros(layer.channels)})
            n_in = layer.channels
        return layers
    width = backbone.width
    params: dict[str, Any] = {
        "conv1": {"weight": _init_convolution(generator, 3, width, 7)},
        "bn1": _init_batch_norm(width),
    }
    n_in = width
    for stage in range(4):
        n_out = width << stage
        params[f"layer{stage + 1}"] = [
            _init_block(generator, n_in, n_out, halves=stage > 0),
            _init_block(generator, n_out, n_out, halves=False),
        ]
        n_in = n_out
    return params


def _init_block(generator: np.random.Generator, n_in: int, n_out: int, halves: bool) -> Params:
    block = {
        "conv1": {"weight": _init_convolution(generator, n_in, n_out, 3)},
        "bn1": _init_batch_norm(n_out),
        "conv2": {"weight": _init_convolution(generator, n_out, n_out, 3)},
        "bn2": _init_batch_norm(n_out),
    }
    if halves:
        weight = _init_convolution(generator, n_in, n_out, 1)
        block["downsample"] = [{"weight": weight}, _init_batch_norm(n_out)]
    return block


# ---- forward


def normalise_pixels(params: Params, image: Array) -> Array:
    """(B, H, W, 3) uint8 -> float32; mean and scale (3) act on pixels in [0, 1]."""
    return (image.astype(jnp.float32) / 255.0 - params["mean"]) * params["scale"]


def features(params: Params, backbone: Any, x: Array) -> Array:
    """Normalised images (B, H, W, 3) -> (B, H', W', C)."""
    if isinstance(backbone, Cnn):
        for layer, weights in zip(backbone.layers, params, strict=True):
            x = jax.nn.relu(_convolve_patches(weights["weight"], x, layer.stride) + weights["bias"])
        return x
    x = jax.nn.relu(_batch_norm(params["bn1"], _convolve(params["conv1"]["weight"], x, 2)))
    # 3 x 3 maximum, stride 2; the border is below everything
    padding = ((0, 0), (1, 1), (1, 1), (0, 0))
    x = lax.reduce_window(x, -jnp.inf, lax.max, (1, 3, 3, 1), (1, 2, 2, 1), padding)
    for stage in range(4):
        for index, block in enumerate(params[f"layer{stage + 1}"]):
            x = _block(block, x, 2 if stage > 0 and index == 0 else 1)
    return x


def feature_size(backbone: Any, camera: Camera) -> tuple[int, int]:
    """Height and width of a camera's features."""
    if isinstance(backbone, Cnn):
        kernels = [(layer.kernel, layer.stride) for layer in backbone.layers]
    else:
        kernels = [
            (7, 2),
            (3, 2),
            (3, 2),
            (3, 2),
            (3, 2),
        ]  # conv1, the maximum, the first block of layer 2, 3, 4
    height, width = camera.height, camera.width
    for kernel, stride in kernels:
        padding = 2 * (kernel // 2)
        height, width = (height + padding - kernel) // stride + 1, (width + padding - kernel) // stride + 1
    return height, width


def _convolve(weight: Array, x: Array, stride: int) -> Array:
    margin = weight.shape[-1] // 2
    return lax.conv_general_dilated(
        x, weight, (stride, stride), [(margin, margin)] * 2, dimension_numbers=("NHWC", "OIHW", "NHWC")
    )


def _convolve_patches(weight: Array, x: Array, stride: int) -> Array:
    """The same as one matrix product over all patches. With few channels XLA's convolution and its gradient take half
    as long again on a CPU (16 to 32 channels, 64 px, batch 128, one core)."""
    kernel, (batch, height, width, channels) = weight.shape[-1], x.shape
    out_height, out_width = (height - 1) // stride + 1, (width - 1) // stride + 1
    margin = kernel // 2
    x = jnp.pad(x, ((0, 0), (margin, margin), (margin, margin), (0, 0)))
    patches = [
        x[:, i : i + stride * (out_height - 1) + 1 : stride, j : j + stride * (out_width - 1) + 1 : stride]
        for i in range(kernel)
        for j in range(kernel)
    ]
    rows = jnp.concatenate(patches, axis=3).reshape(-1, kernel * kernel * channels)
    matrix = weight.transpose(2, 3, 1, 0).reshape(len(rows[0]), -1)
    return (rows @ matrix).reshape(batch, out_height, out_width, -1)


def _batch_norm(params: Params, x: Array) -> Array:
    scale = params["weight"] * lax.rsqrt(params["running_var"] + BATCH_NORM_EPSILON)
    return (x - params["running_mean"]) * scale + params["bias"]


def _block(params: Params, x: Array, stride: int) -> Array:
    y = jax.nn.relu(_batch_norm(params["bn1"], _convolve(params["conv1"]["weight"], x, stride)))
    y = _batch_norm(params["bn2"], _convolve(params["conv2"]["weight"], y, 1))
    if "downsample" in params:
        convolution, norm = params["downsample"]
        x = _batch_norm(norm, _convolve(convolution["weight"], x, stride))
    return jax.nn.relu(x + y)


# ---- positions


def sine_positions(height: int, width: int, size: int) -> np.ndarray:
    """(height width, size): ACT's 2-D sine embedding; the row's position fills the first half, the column's the rest.

    Rows and columns count from 1 and are scaled to end at 2 pi; wavelengths grow geometrically to 10 000, sine and
    cosine in turn. size must be a multiple of 4.
    """
    half = size // 2
    pair = np.arange(half) // 2
    wavelength = np.float64(10_000.0) ** (2.0 * pair / half)

    def one_axis(n: int) -> np.ndarray:
        angle = (np.arange(1, n + 1) / (n + 1e-6) * 2.0 * math.pi)[:, None] / wavelength
        return np.where(np.arange(half) % 2 == 0, np.sin(angle), np.cos(angle))  # (n, half)

    rows = np.repeat(one_axis(height)[:, None], width, axis=1)
    columns = np.repeat(one_axis(width)[None], height, axis=0)
    return np.concatenate([rows, columns], axis=2).reshape(height * width, size).astype(np.float32)
