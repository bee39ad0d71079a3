"""The policy file: a policy with its normaliser and golden examples in one safetensors file (little endian).

Network   one tensor for each array of the network's parameters; the name is the path to it: "actor.layers.0.weight".
          The networks and their configs: `tandem.learner.networks`. float32; matrices may be bfloat16.
Others    normalizer.mean / .scale (O): x = (observation - mean) * scale; golden.observation (N, O) raw,
          golden.chunk (N, h, A), golden.noise (N, noise_size) and golden.image.{camera} (N, H, W, 3) uint8 where used.
Metadata  strings; see `PolicyHeader`.

Files are written whole (temporary file, fsync, rename) and byte for byte the same for the same policy.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ml_dtypes
import numpy as np
from numpy.typing import NDArray

FORMAT = "tandem-policy-1"
COMPOSED = ("best_of_n", "grasp", "encoded")  # architectures of several networks
Array = NDArray[Any]

BFLOAT16 = np.dtype(ml_dtypes.bfloat16)
_DTYPES = {
    "F32": np.dtype("<f4"),
    "BF16": BFLOAT16,
    "I32": np.dtype("<i4"),
    "U32": np.dtype("<u4"),
    "U8": np.dtype("u1"),
}
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}
_MAX_HEADER_BYTES = 16 << 20


class PolicyFileError(Exception):
    """A sentence: which file, what is wrong with it."""


@dataclass(frozen=True)
class PolicyHeader:
    """The facts in a policy file's metadata."""

    config: dict[str, Any]  # the network's structure: JSON of a head's Config
    observation: list[str]  # names, in order
    action: list[str]  # active axes, in wire order (or joints, in a policy that is not for our controller)
    task: str
    method: str
    execution: dict[str, Any]  # method.execution of the scenario
    discount: float
    version: int
    env_steps: int  # training steps when it was written
    updates: int  # gradient updates, warm start included
    episodes_trained_through: int
    git_revision: str
    architecture: str = "mlp"

    def to_metadata(self) -> dict[str, str]:
        texts = {"format": FORMAT}
        for name, value in vars(self).items():
            texts[name] = json.dumps(value) if isinstance(value, dict | list) else str(value)
        return texts

    @staticmethod
    def from_metadata(texts: Mapping[str, str]) -> PolicyHeader:
        """Raises KeyError or ValueError when the metadata is not that of a policy file."""
        if texts["format"] != FORMAT:
            raise ValueError(f"its format is {texts['format']!r}, not {FORMAT!r}")
        return PolicyHeader(
            config=json.loads(texts["config"]),
            observation=json.loads(texts["observation"]),
            action=json.loads(texts["action"]),
            task=texts["task"],
            method=texts["method"],
            execution=json.loads(texts["execution"]),
            discount=float(texts["discount"]),
            version=int(texts["version"]),
            env_steps=int(texts["env_steps"]),
            updates=int(texts["updates"]),
            episodes_trained_through=int(texts["episodes_trained_through"]),
            git_revision=texts["git_revision"],
            architecture=texts["architecture"],
        )


@dataclass(frozen=True)
class WrittenFile:
    """What POLICY_ANNOUNCE says about a file."""

    path: Path
    n_bytes: int
    sha256: str


def write_policy(
    path: Path,
    header: PolicyHeader,
    params: Any,
    mean: Array,
    scale: Array,
    golden: Mapping[str, Array],
    bfloat16: bool = False,
) -> WrittenFile:
    """Writes the network `params` of the architecture that the header names.

    golden: observation (N, O), chunk (N, h, A), and where used noise and image.{camera}.
    bfloat16: store the network's matrices so; the golden chunks must then be those of `rounded(params)`.
    Raises PolicyFileError rather than writing a number that is not finite: such a policy must not reach the arm.
    """
    # the parts of these have names of their own: actor.0, edit, critic.0; grasp; encoder
    tensors = named_arrays(params, "" if header.architecture in COMPOSED else "actor")
    matrices = {name for name, array in tensors.items() if _is_matrix(name, array)}
    tensors |= {"normalizer.mean": mean, "normalizer.scale": scale}
    tensors |= {f"golden.{name}": array for name, array in golden.items()}
    for name, array in tensors.items():
        array = np.asarray(array)
        if name.startswith("golden.image."):
            tensors[name] = array.astype(np.uint8, casting="no")
            continue
        tensors[name] = array.astype(BFLOAT16 if bfloat16 and name in matrices else np.float32)
        if not np.isfinite(tensors[name]).all():
            raise PolicyFileError(
                f"{path}: {name} holds a number that is not finite; the training has diverged."
            )
    return write_file(path, encode_safetensors(tensors, header.to_metadata()))


def named_arrays(tree: Any, name: str = "") -> dict[str, Array]:
    """The arrays in dicts and lists, named by their path: {"layers": [{"bias": b}]} -> {"layers.0.bias": b}.

    This gives the tensors of the policy file their names.
    """
    if isinstance(tree, Mapping):
        parts = list(tree.items())
    elif isinstance(tree, list | tuple):
        parts = list(enumerate(tree))
    else:
        return {name: tree}
    named: dict[str, Array] = {}
    for key, part in parts:
        named |= named_arrays(part, f"{name}.{key}" if name else str(key))
    return named


def network(tensors: Mapping[str, Array], architecture: str) -> Any:
    """The network in the tensors of a policy file: names back to dicts and lists; the inverse of `named_arrays`."""
    tree: dict[str, Any] = {}
    prefix = "" if architecture in COMPOSED else "actor."
    for name, array in tensors.items():
        if name.startswith(("normalizer.", "golden.")):
            continue
        *path, last = name.removeprefix(prefix).split(".")
        node = tree
        for key in path:
            node = node.setdefault(key, {})
        node[last] = np.asarray(array, np.float32)

    def lists(node: Any) -> Any:
        if not isinstance(node, dict):
            return node
        parts = {key: lists(part) for key, part in node.items()}
        return [parts[str(i)] for i in range(len(parts))] if all(key.isdigit() for key in parts) else parts

    return lists(tree)


def rounded(params: Any) -> Any:
    """The same network in float32 with its matrices rounded to bfloat16: what a bfloat16 file computes."""

    def visit(tree: Any, key: str) -> Any:
        if isinstance(tree, Mapping):
            return {name: visit(part, name) for name, part in tree.items()}
        if isinstance(tree, list | tuple):
            return [visit(part, key) for part in tree]
        array = np.asarray(tree)
        return array.astype(BFLOAT16).astype(np.float32) if _is_matrix(key, array) else array

    return visit(params, "")


def _is_matrix(name: str, array: Array) -> bool:
    """Dense weights; convolutions stay float32, their batch norms are folded into them when they are loaded."""
    return name.rpartition(".")[2] == "weight" and array.ndim == 2


def read_header(path: Path) -> PolicyHeader:
    """The metadata alone; reads a few kilobytes. Raises PolicyFileError."""
    _, texts, _ = _read_head(path)
    try:
        return PolicyHeader.from_metadata(texts)
    except (KeyError, ValueError, TypeError) as error:
        raise PolicyFileError(f"{path} is not a policy file: {error}.") from None


def describe(path: Path) -> WrittenFile:
    """Size and digest of a file that was written earlier."""
    data = path.read_bytes()
    return WrittenFile(path, len(data), hashlib.sha256(data).hexdigest())


# ---- safetensors, and files that are whole or not there


def encode_safetensors(tensors: Mapping[str, Array], metadata: Mapping[str, str]) -> bytes:
    """Tensors sorted by name, without holes. Written here because the library does not keep the metadata's order, and
    the same policy must give the same bytes."""
    header: dict[str, Any] = {"__metadata__": dict(sorted(metadata.items()))}
    parts: list[bytes] = []
    offset = 0
    for name, array in sorted(tensors.items()):
        array = np.asarray(array)
        data = array.tobytes()  # C order; this machine is little endian like the format
        header[name] = {
            "dtype": _NAMES[array.dtype],
            "shape": list(array.shape),
            "data_offsets": [offset, offset + len(data)],
        }
        parts.append(data)
        offset += len(data)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # the data begins aligned
    return struct.pack("<Q", len(text)) + text + b"".join(parts)


def read_safetensors(path: Path) -> tuple[dict[str, Array], dict[str, str]]:
    """All tensors and the metadata. Raises PolicyFileError."""
    entries, texts, start = _read_head(path)
    data = path.read_bytes()[start:]
    tensors = {}
    try:
        for name, entry in entries.items():
            if entry["dtype"] not in _DTYPES:
                raise PolicyFileError(
                    f"{path}: {name} is {entry['dtype']}; known are {', '.join(_DTYPES)}. Save it as F32."
                )
            begin, end = entry["data_offsets"]
            tensors[name] = (
                np.frombuffer(data[begin:end], _DTYPES[entry["dtype"]]).reshape(entry["shape"]).copy()
            )
    except (KeyError, ValueError, TypeError) as error:
        raise PolicyFileError(f"{path} is damaged: {error}.") from None
    return tensors, texts


def _read_head(path: Path) -> tuple[dict[str, Any], dict[str, str], int]:
    """Tensor entries, metadata, and where the data begins."""
    try:
        with path.open("rb") as file:
            (length,) = struct.unpack("<Q", file.read(8))
            if length > _MAX_HEADER_BYTES:
                raise ValueError(f"its header of {length} bytes would be longer than {_MAX_HEADER_BYTES}")
            entries = json.loads(file.read(length))
        return entries, entries.pop("__metadata__", {}), 8 + length
    except OSError as error:
        raise PolicyFileError(f"{path} can't be read ({error.strerror}).") from None
    except (ValueError, AttributeError, struct.error) as error:
        raise PolicyFileError(f"{path} is not a safetensors file: {error}.") from None


def write_file(path: Path, data: bytes) -> WrittenFile:
    """Temporary file in the same folder, fsync, rename, fsync of the folder: readers see the old or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.part")
    with partial.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
    return WrittenFile(path, len(data), hashlib.sha256(data).hexdigest())
