"""What evaluating a policy once takes at least: weights to read and arithmetic to do.

Counted: dense layers, attention, convolutions, a multiply-add as two operations; not biases, norms and activations.
Left out is what does not depend on the observation, and what flow steps share is counted once. Convolutions count as
written; Winograd's algorithm needs fewer operations for the 3 x 3 ones, so that a good program may beat this limit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from tandem.policy_bench.policies import BenchPolicy

FLOAT = 4  # bytes
Config = Mapping[str, Any]


@dataclass(frozen=True)
class Cost:
    weights: int  # bytes, the working set
    read: int  # bytes of weights read in an evaluation; those of a flow's field once a step
    flops: int

    def __add__(self, other: Cost) -> Cost:
        return Cost(self.weights + other.weights, self.read + other.read, self.flops + other.flops)

    def __mul__(self, times: int) -> Cost:
        return Cost(times * self.weights, times * self.read, times * self.flops)


def dense(n_in: int, n_out: int, rows: int = 1) -> Cost:
    return Cost(FLOAT * n_in * n_out, FLOAT * n_in * n_out, 2 * n_in * n_out * rows)


def arithmetic(flops: int) -> Cost:
    return Cost(0, 0, flops)


NOTHING = arithmetic(0)


def of(policy: BenchPolicy) -> Cost:
    config, axes = policy.config, len(policy.action)
    if policy.architecture == "mlp":
        return layers([policy.observation, *config["hidden"], policy.horizon * axes])
    if policy.architecture == "flow":
        return flow(config, policy.observation, axes, 1)
    if policy.architecture == "best_of_n":
        return best_of_n(config, policy.observation, axes)
    return act(config, axes)


def layers(sizes: list[int], rows: int = 1) -> Cost:
    return sum((dense(n_in, n_out, rows) for n_in, n_out in pairwise(sizes)), NOTHING)


def flow(config: Config, n_observation: int, axes: int, samples: int) -> Cost:
    """The first layer's part of the observation is needed once, that of the time never."""
    n_chunk = config["horizon"] * axes
    step = layers([n_chunk, *config["hidden"], n_chunk], samples)
    steps = Cost(step.weights, config["steps"] * step.read, config["steps"] * step.flops)
    return dense(n_observation, config["hidden"][0]) + steps


def best_of_n(config: Config, n_observation: int, axes: int) -> Cost:
    (head,), critic = config["heads"], config["critic"]
    samples, n_chunk = head["samples"], config["horizon"] * axes
    member = dense(n_observation, critic["hidden"][0])
    member += layers([n_chunk, *critic["hidden"], 1], samples)
    return flow(head["config"], n_observation, axes, samples) + member * critic["members"]


def act(config: Config, axes: int) -> Cost:
    d, ff, h = config["model_size"], config["feedforward"], config["horizon"]
    total, tokens = NOTHING, 1  # the latent is zero, its token known
    for token in config["tokens"]:
        total, tokens = total + dense(token["size"], d), tokens + 1
    for camera in config["cameras"]:
        network, positions = resnet18(config["backbone"]["width"], camera["height"], camera["width"])
        total += network + dense(8 * config["backbone"]["width"], d, positions)
        tokens += positions

    feedforward = dense(d, ff, tokens) + dense(ff, d, tokens)
    attention = dense(d, d, tokens) * 4 + arithmetic(4 * tokens * tokens * d)
    total += (attention + feedforward) * config["encoder_layers"]

    # keys and values of the memory, the queries' attention to it, its output, feedforward
    cross = dense(d, d, tokens) * 2 + arithmetic(4 * h * tokens * d) + dense(d, d, h)
    layer = cross + dense(d, ff, h) + dense(ff, d, h)
    # the first layer's self-attention sees constants, and so do its queries
    later = layer + dense(d, d, h) * 5 + arithmetic(4 * h * h * d)
    return total + layer + later * (config["decoder_layers"] - 1) + dense(d, axes, h)


def resnet18(width: int, height: int, columns: int) -> tuple[Cost, int]:
    """Its cost and the pixels of what comes out."""

    def half(size: int) -> int:
        return (size + 1) // 2

    def convolution(n_in: int, n_out: int, kernel: int) -> Cost:
        return dense(n_in * kernel * kernel, n_out, rows * columns)

    rows, columns = half(height), half(columns)
    total = convolution(3, width, 7)
    rows, columns = half(rows), half(columns)  # the maximum
    total += convolution(width, width, 3) * 4
    n_in = width
    for _ in range(3):
        rows, columns, n_out = half(rows), half(columns), 2 * n_in
        total += convolution(n_in, n_out, 3) + convolution(n_in, n_out, 1) + convolution(n_out, n_out, 3) * 3
        n_in = n_out
    return total, rows * columns
