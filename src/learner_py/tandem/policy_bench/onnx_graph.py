"""A small builder of ONNX graphs: one method a layer, called in the order in which data flows.

Sequences and batches are (rows, features), images (1, C, H, W). Weights are (out, in) as in the policy file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

Array = NDArray[Any]
Tensors = Mapping[str, Array]

OPSET = 23  # the first with Attention, which ONNX Runtime does faster than its parts
IR_VERSION = 11
MLP_EPSILON, TRANSFORMER_EPSILON, BATCH_NORM_EPSILON = 1e-6, 1e-5, 1e-5


class GraphBuilder:
    """Values are names of ONNX values; every method adds nodes and returns the name of what they give."""

    def __init__(self, tensors: Tensors) -> None:
        self.tensors = tensors
        self._nodes: list[Any] = []
        self._constants: dict[str, Any] = {}
        self._inputs: list[Any] = []

    def input(self, name: str, shape: Sequence[int], pixels: bool = False) -> str:
        kind = TensorProto.UINT8 if pixels else TensorProto.FLOAT
        self._inputs.append(helper.make_tensor_value_info(name, kind, list(shape)))
        return name

    def model(self, output: str, shape: Sequence[int]) -> Any:
        """The finished graph; its output is called "chunk"."""
        self._nodes.append(helper.make_node("Identity", [output], ["chunk"]))
        found = [helper.make_tensor_value_info("chunk", TensorProto.FLOAT, list(shape))]
        graph = helper.make_graph(self._nodes, "policy", self._inputs, found, list(self._constants.values()))
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
        )
        onnx.checker.check_model(model)
        return model

    def op(self, kind: str, *inputs: str, **attributes: Any) -> str:
        name = f"{kind}_{len(self._nodes)}"
        self._nodes.append(helper.make_node(kind, list(inputs), [name], name=name, **attributes))
        return name

    def constant(self, array: Any, name: str = "") -> str:
        """name: of a tensor of the file, to be there once however often it is used."""
        name = name or f"constant_{len(self._constants)}"
        if name not in self._constants:
            array = np.asarray(array)
            if array.dtype not in (np.int64, np.uint8):
                array = array.astype(np.float32)
            self._constants[name] = numpy_helper.from_array(array, name)
        return name

    def tensor(self, name: str) -> str:
        return self.constant(self.tensors[name], name)

    def reshape(self, x: str, *shape: int) -> str:
        return self.op("Reshape", x, self.constant(np.array(shape, np.int64)))

    def first(self, x: str) -> str:
        """The first number of an input, of shape (1)."""
        axes = len(self._sizes(x))
        bounds = [self.constant(np.full(axes, end, np.int64)) for end in (0, 1)]
        return self.reshape(self.op("Slice", x, *bounds), 1)

    # ---- layers

    def normalize(self, observation: str) -> str:
        centred = self.op("Sub", observation, self.tensor("normalizer.mean"))
        return self.op("Mul", centred, self.tensor("normalizer.scale"))

    def dense(self, x: str, prefix: str) -> str:
        """(n, in) -> (n, out)"""
        return self.op("Gemm", x, self.tensor(f"{prefix}.weight"), self.tensor(f"{prefix}.bias"), transB=1)

    def activate(self, x: str, kind: str) -> str:
        if kind == "gelu":
            return self.op("Gelu", x, approximate="tanh")
        return self.op({"relu": "Relu", "tanh": "Tanh"}[kind], x)

    def layer_norm(self, x: str, scale: str, offset: str, epsilon: float) -> str:
        return self.op(
            "LayerNormalization", x, self.tensor(scale), self.tensor(offset), axis=-1, epsilon=epsilon
        )

    def mlp(self, x: str, prefix: str, config: Mapping[str, Any]) -> str:
        """Hidden layers act(norm(W x + b)), then a linear one."""
        for i in range(len(config["hidden"])):
            layer = f"{prefix}.layers.{i}"
            x = self.dense(x, layer)
            if config["layer_norm"]:
                x = self.layer_norm(x, f"{layer}.norm_scale", f"{layer}.norm_offset", MLP_EPSILON)
            x = self.activate(x, config["activation"])
        return self.dense(x, f"{prefix}.layers.{len(config['hidden'])}")

    def add_norm(self, x: str, y: str, prefix: str) -> str:
        """Post-norm residual of a transformer layer."""
        added = self.op("Add", x, y)
        return self.layer_norm(added, f"{prefix}.scale", f"{prefix}.offset", TRANSFORMER_EPSILON)

    def feedforward(self, x: str, prefix: str, activation: str) -> str:
        return self.dense(
            self.activate(self.dense(x, f"{prefix}.feedforward1"), activation), f"{prefix}.feedforward2"
        )

    def attention(self, query: str, key: str, value: str, prefix: str, heads: int) -> str:
        """query (n, d), key and value (m, d) -> (n, d)"""
        batch = self.constant(np.array([0], np.int64))
        q, k, v = (
            self.op("Unsqueeze", self.dense(x, f"{prefix}.{name}"), batch)
            for name, x in {"query": query, "key": key, "value": value}.items()
        )
        y = self.op("Attention", q, k, v, q_num_heads=heads, kv_num_heads=heads)
        return self.dense(self.op("Squeeze", y, batch), f"{prefix}.output")

    # ---- images

    def image(self, pixels: str, prefix: str) -> str:
        """(H, W, 3) uint8 -> (1, 3, H, W) normalised"""
        height, width, _ = self._sizes(pixels)
        x = self.op("Cast", pixels, to=TensorProto.FLOAT)
        x = self.op("Transpose", self.reshape(x, 1, height, width, 3), perm=[0, 3, 1, 2])
        mean = self.tensors[f"{prefix}.image.mean"].astype(np.float64).reshape(1, 3, 1, 1)
        scale = self.tensors[f"{prefix}.image.scale"].astype(np.float64).reshape(1, 3, 1, 1)
        x = self.op("Sub", x, self.constant(255.0 * mean))
        return self.op("Mul", x, self.constant(scale / 255.0))

    def _sizes(self, name: str) -> list[int]:
        """Shape of an input."""
        value = next(each for each in self._inputs if each.name == name)
        return [axis.dim_value for axis in value.type.tensor_type.shape.dim]

    def convolution(self, x: str, weight: str, norm: str, stride: int) -> str:
        """With the frozen batch norm folded in, as exporters do; padding kernel / 2."""
        t = self.tensors
        W = t[weight].astype(np.float64)
        scale = t[f"{norm}.weight"] / np.sqrt(
            t[f"{norm}.running_var"].astype(np.float64) + BATCH_NORM_EPSILON
        )
        bias = t[f"{norm}.bias"] - scale * t[f"{norm}.running_mean"]
        kernel = W.shape[2]
        return self.op(
            "Conv",
            x,
            self.constant(W * scale[:, None, None, None]),
            self.constant(bias),
            kernel_shape=[kernel, kernel],
            strides=[stride, stride],
            pads=[kernel // 2] * 4,
        )

    def resnet18(self, x: str, prefix: str) -> str:
        """(1, 3, H, W) -> (1, C, H / 32, W / 32)"""
        x = self.op("Relu", self.convolution(x, f"{prefix}.conv1.weight", f"{prefix}.bn1", 2))
        x = self.op("MaxPool", x, kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1])
        for layer in range(1, 5):
            for i in range(2):
                block, stride = f"{prefix}.layer{layer}.{i}", 2 if layer > 1 and i == 0 else 1
                y = self.op("Relu", self.convolution(x, f"{block}.conv1.weight", f"{block}.bn1", stride))
                y = self.convolution(y, f"{block}.conv2.weight", f"{block}.bn2", 1)
                if stride == 2:
                    x = self.convolution(x, f"{block}.downsample.0.weight", f"{block}.downsample.1", 2)
                x = self.op("Relu", self.op("Add", y, x))
        return x
