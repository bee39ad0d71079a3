"""Policies that the controller must refuse, or survive, made from a good file of the run. Files go to RUN/bad/."""

from __future__ import annotations

import hashlib
import json
import random
from pathlib import Path
from typing import Any

import numpy as np
from tandem_lcm.tandem.policy_announce_t import policy_announce_t

from tandem.policy_file import Array, describe, encode_safetensors, read_safetensors, write_file
from tandem.wire import utime

# Beyond any version that a learner of a soak reaches.
FIRST_VERSION = 1_000_000

# What the controller should say: these never come into force ...
REFUSED = (
    "truncated",
    "wrong digest",
    "NaN tensor",
    "other task",
    "other horizon",
    "missing",
    "folder",
    "device",
    "taken number",
)
# ... and these do: one whose outputs for real observations are not finite, and one whose number makes all
# later ones stale.
TAKEN = ("silent", "far number")
WITHOUT_A_FILE = ("missing", "folder", "device")


def bad_policy(
    kind: str, rng: random.Random, run: Path, good: Path | None, number: int
) -> policy_announce_t | None:
    """The announcement of a bad policy; None when it takes a good one and there is none yet.

    number: how many were made before, so that each has a version of its own.
    """
    message = policy_announce_t()
    message.utime = utime()
    message.version = FIRST_VERSION + number
    message.episodes_trained_through = -1
    message.sha256 = hashlib.sha256(rng.randbytes(8)).hexdigest()
    file = run / "bad" / f"{number:04d}.safetensors"
    message.path = str(file.relative_to(run))
    if kind in WITHOUT_A_FILE:
        message.n_bytes = 1000
        message.path = {"missing": message.path, "folder": ".", "device": "/dev/zero"}[kind]
        return message
    if good is None:
        return None
    tensors, texts = read_safetensors(good)
    if kind == "taken number":  # the learner's own, with another content
        message.version = int(texts["version"])
    texts["version"] = str(message.version)
    _spoil(kind, tensors, texts)
    data = encode_safetensors(tensors, texts)
    if kind == "truncated":
        data = data[: rng.randrange(len(data))]
    write_file(file, data)
    written = describe(file)
    message.n_bytes = written.n_bytes
    if kind not in ("wrong digest", "taken number"):
        message.sha256 = written.sha256
    return message


def _spoil(kind: str, tensors: dict[str, Array], texts: dict[str, str]) -> None:
    if kind == "NaN tensor":
        tensors["actor.layers.0.weight"][0, 0] = np.nan
    elif kind == "other task":
        texts["task"] = "pick_cube"
    elif kind == "other horizon":
        config = json.loads(texts["config"])
        config["horizon"] += 1
        texts["config"] = json.dumps(config)
    elif kind == "silent":
        _silence(tensors, json.loads(texts["config"]))


def _silence(tensors: dict[str, Array], config: dict[str, Any]) -> None:
    """Weights that give inf - inf for every observation but the normaliser's mean, which all golden examples get.

    Two neurons of the first layer are large for a first number above and below its mean; the next layer makes infinity
    of either; the last one subtracts it from itself.
    """
    n_layers = len(config["hidden"]) + 1
    if n_layers != 3 or config["layer_norm"] or config["activation"] != "relu":
        raise ValueError("a silent policy is made from two hidden layers with relu and without LayerNorm.")
    first, second, last = (tensors[f"actor.layers.{i}.weight"] for i in range(3))
    for i in range(3):
        tensors[f"actor.layers.{i}.bias"][:] = 0.0
    first[:2] = 0.0
    first[0, 0], first[1, 0] = 3e38, -3e38
    second[:2] = 0.0
    second[:2, :2] = 1e30
    last[:, 0], last[:, 1] = 1.0, -1.0
    golden = tensors["golden.observation"]
    golden[:] = tensors["normalizer.mean"]
    tensors["golden.chunk"][:] = 0.0  # tanh of the last bias
