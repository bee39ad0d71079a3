"""The benchmark's policies as ONNX graphs, straight from the tensors of a policy file.

Inputs: observation (1, O) raw, noise (noise_size) when there is any, image.{camera} (H, W, 3) uint8 as they come from a
camera. Output: chunk (h, A). What does not depend on the inputs is left to the engines, which fold it when they load.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from onnx import TensorProto

from tandem.policy_bench.onnx_graph import TRANSFORMER_EPSILON, GraphBuilder, Tensors


def build(architecture: str, config: Mapping[str, Any], tensors: Tensors) -> Any:
    """The ONNX model of a policy. tensors: those of its file, golden examples among them."""
    g = GraphBuilder(tensors)
    x = g.normalize(g.input("observation", (1, tensors["normalizer.mean"].size)))
    shape = tensors["golden.chunk"].shape[1:]
    noise = g.input("noise", tensors["golden.noise"].shape[1:]) if "golden.noise" in tensors else ""
    if architecture == "mlp":
        chunk = g.op("Tanh", g.mlp(x, "actor", config))
    elif architecture == "flow":
        chunk = flow(g, x, g.reshape(noise, 1, -1), "actor", config)
    elif architecture == "best_of_n":
        chunk = best_of_n(g, x, noise, config)
    else:
        chunk = act(g, x, config)
    return g.model(g.reshape(chunk, *shape), shape)


def build_idle(tensors: Tensors) -> Any:
    """A model with the inputs of `build`'s that computes next to nothing: what a call costs.

    Its output, "chunk" too, is the sum of one number of each input; OpenVINO drops an input that nothing depends on.
    """
    g = GraphBuilder(tensors)
    total = g.first(g.input("observation", (1, tensors["normalizer.mean"].size)))
    if "golden.noise" in tensors:
        total = g.op("Add", total, g.first(g.input("noise", tensors["golden.noise"].shape[1:])))
    for name, array in tensors.items():
        if name.startswith("golden.image."):
            pixels = g.input(name.removeprefix("golden."), array.shape[1:], pixels=True)
            number = g.op("Cast", g.first(pixels), to=TensorProto.FLOAT)
            total = g.op("Add", total, number)
    return g.model(total, [1])


def flow(g: GraphBuilder, x: str, a: str, prefix: str, config: Mapping[str, Any], rows: int = 1) -> str:
    """x (rows, O), noise a (rows, h A) -> (rows, h A); the loop unrolled."""
    for step in range(config["steps"]):
        phi = g.constant(np.repeat(time_features(step / config["steps"], config["time_features"]), rows, 0))
        v = g.mlp(g.op("Concat", x, a, phi, axis=1), prefix, config)
        a = g.op("Add", a, g.op("Mul", v, g.constant(1.0 / config["steps"])))
    return g.op("Clip", a, g.constant(-1.0), g.constant(1.0))


def time_features(t: float, count: int) -> np.ndarray:
    """(1, count)"""
    angles = np.pi * t * np.arange(1, count // 2 + 1)
    return np.concatenate([np.cos(angles), np.sin(angles)])[None]


def best_of_n(g: GraphBuilder, x: str, noise: str, config: Mapping[str, Any]) -> str:
    """x (1, O), noise (n h A) -> the winner (1, h A) among n samples of a flow."""
    (head,), critic = config["heads"], config["critic"]
    samples = head["samples"]
    x = g.op("Expand", x, g.constant(np.array([samples, 1], np.int64)))
    chunks = flow(g, x, g.reshape(noise, samples, -1), "actor.0", head["config"], samples)
    seen = g.op("Concat", x, chunks, axis=1)
    values = [g.mlp(seen, f"critic.{member}", critic) for member in range(critic["members"])]
    score = g.op("ReduceMean", g.op("Concat", *values, axis=1), g.constant(np.array([1])), keepdims=0)
    return g.op("Gather", chunks, g.op("ArgMax", score, axis=0, keepdims=1), axis=0)


def act(g: GraphBuilder, x: str, config: Mapping[str, Any]) -> str:
    """x (1, O) and the cameras' images -> (h, A)"""
    tokens, positions = [], [g.tensor("actor.token_position")]
    tokens.append(g.dense(g.constant(np.zeros((1, config["latent_size"]))), "actor.latent"))
    begin = 0
    for i, token in enumerate(config["tokens"]):
        end = begin + token["size"]
        part = g.op("Slice", x, *(g.constant(np.array([value])) for value in (begin, end, 1)))
        tokens.append(g.dense(part, f"actor.tokens.{i}"))
        begin = end
    for camera in config["cameras"]:
        name = camera["name"]
        pixels = g.input(f"image.{name}", (camera["height"], camera["width"], 3), pixels=True)
        features = g.resnet18(g.image(pixels, "actor"), "actor.backbone")  # (1, C, h', w')
        channels = g.tensors["actor.camera_projection.weight"].shape[1]
        rows = g.op("Transpose", g.reshape(features, channels, -1), perm=[1, 0])
        tokens.append(g.dense(rows, "actor.camera_projection"))
        positions.append(g.tensor(f"actor.camera_position.{name}"))
    y = g.op("Concat", *tokens, axis=0)
    position = g.op("Concat", *positions, axis=0)

    heads, activation = config["heads"], config["activation"]
    for i in range(config["encoder_layers"]):
        layer = f"actor.encoder.{i}"
        placed = g.op("Add", y, position)
        y = g.add_norm(y, g.attention(placed, placed, y, f"{layer}.attention", heads), f"{layer}.norm1")
        y = g.add_norm(y, g.feedforward(y, layer, activation), f"{layer}.norm2")

    memory, placed_memory = y, g.op("Add", y, position)
    query = g.tensor("actor.query_position")
    z = g.constant(np.zeros((config["horizon"], config["model_size"])))
    for i in range(config["decoder_layers"]):
        layer = f"actor.decoder.{i}"
        placed = g.op("Add", z, query)
        seen = g.attention(placed, placed, z, f"{layer}.self_attention", heads)
        z = g.add_norm(z, seen, f"{layer}.norm1")
        placed = g.op("Add", z, query)
        seen = g.attention(placed, placed_memory, memory, f"{layer}.cross_attention", heads)
        z = g.add_norm(z, seen, f"{layer}.norm2")
        z = g.add_norm(z, g.feedforward(z, layer, activation), f"{layer}.norm3")

    z = g.layer_norm(z, "actor.norm.scale", "actor.norm.offset", TRANSFORMER_EPSILON)
    action = g.dense(z, "actor.action")
    if config["output"] == "tanh":
        return g.op("Tanh", action)
    scaled = g.op("Mul", action, g.tensor("actor.output.scale"))
    return g.op("Add", scaled, g.tensor("actor.output.offset"))
