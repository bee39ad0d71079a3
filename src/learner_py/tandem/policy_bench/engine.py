"""A peer as a contender: `python -m tandem.policy_bench.engine ENGINE FILE`, a program of its own per policy.

ENGINE   onnxruntime, openvino or xla; each with one thread, in float32, with every input and output in place before a
         call, as somebody would who wants the best of it.
Orders on stdin, one a line, each answered by a line of JSON, as bench/policy/contender.h says:

    run N    N evaluations -> N microseconds
    call N   as many of a function with the same inputs that computes nothing: what a call from Python costs
    chunk I  the chunk of example I -> h A numbers
"""

from __future__ import annotations

import gc
import itertools
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tandem.learner import xla
from tandem.policy_file import PolicyHeader, read_safetensors

Array = Any
Tensors = dict[str, Array]
Call = Callable[[], None]


class Engine:
    """prepare: example i's inputs are put where the next calls take them from; not timed.
    run: one evaluation; call: one that computes nothing; chunk: (h A) what the last `run` gave."""

    version: str
    prepare: Callable[[int], None]
    run: Call
    call: Call
    chunk: Callable[[], Array]


class OnnxRuntime(Engine):
    def __init__(self, header: PolicyHeader, tensors: Tensors) -> None:
        import onnxruntime as ort

        from tandem.policy_bench import onnx_policies

        self.version = ort.__version__
        options = ort.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
        output = ort.OrtValue.ortvalue_from_numpy(np.zeros(tensors["golden.chunk"].shape[1:], np.float32))
        values = [
            {name: ort.OrtValue.ortvalue_from_numpy(array) for name, array in inputs.items()}
            for inputs in graph_inputs(tensors)
        ]

        def bound(model: Any, output: Any) -> tuple[Any, list[Any]]:
            """A session and one binding an example."""
            session = ort.InferenceSession(
                model.SerializeToString(), options, providers=["CPUExecutionProvider"]
            )
            bindings = []
            for inputs in values:
                binding = session.io_binding()
                for name, value in inputs.items():
                    binding.bind_ortvalue_input(name, value)
                binding.bind_ortvalue_output("chunk", output)
                bindings.append(binding)
            return session, bindings

        policy = onnx_policies.build(header.architecture, header.config, tensors)
        session, bindings = bound(policy, output)
        number = ort.OrtValue.ortvalue_from_numpy(np.zeros(1, np.float32))
        idle, idle_bindings = bound(onnx_policies.build_idle(tensors), number)
        current = [0]

        def prepare(i: int) -> None:
            current[0] = i

        self.prepare = prepare
        self.run = lambda: session.run_with_iobinding(bindings[current[0]])
        self.call = lambda: idle.run_with_iobinding(idle_bindings[current[0]])
        self.chunk = lambda: output.numpy().reshape(-1)


class OpenVino(Engine):
    def __init__(self, header: PolicyHeader, tensors: Tensors) -> None:
        import openvino as ov

        from tandem.policy_bench import onnx_policies

        self.version = ov.__version__
        core = ov.Core()
        settings = {
            "PERFORMANCE_HINT": "LATENCY",
            "INFERENCE_PRECISION_HINT": "f32",  # else bfloat16 where the CPU has it
            "INFERENCE_NUM_THREADS": 1,
            "NUM_STREAMS": 1,
            "ENABLE_CPU_PINNING": False,  # the benchmark pins the process
        }
        output = ov.Tensor(aligned(np.zeros(tensors["golden.chunk"].shape[1:], np.float32)), True)
        values = [
            {name: ov.Tensor(aligned(array), True) for name, array in inputs.items()}
            for inputs in graph_inputs(tensors)
        ]

        def request(model: Any) -> Any:
            compiled = core.compile_model(core.read_model(model.SerializeToString()), "CPU", settings)
            return compiled.create_infer_request()

        real = request(onnx_policies.build(header.architecture, header.config, tensors))
        idle = request(onnx_policies.build_idle(tensors))
        real.set_tensor("chunk", output)

        def prepare(i: int) -> None:
            for name, value in values[i].items():
                real.set_tensor(name, value)
                idle.set_tensor(name, value)

        self.prepare = prepare
        self.run = lambda: real.infer(share_outputs=True)
        self.call = lambda: idle.infer(share_outputs=True)
        self.chunk = lambda: output.data.reshape(-1)


class Xla(Engine):
    def __init__(self, header: PolicyHeader, tensors: Tensors) -> None:
        import jax
        import jax.numpy as jnp

        from tandem.learner import networks
        from tandem.policy_bench.weights import tree

        self.version = jax.__version__
        head = networks.HEADS[header.architecture]
        config = networks.read_config(header.architecture, header.config)
        own = {
            name: array for name, array in tensors.items() if not name.startswith(("golden.", "normalizer."))
        }
        params = tree(own) if header.architecture == "best_of_n" else tree(own)["actor"]
        mean, scale = tensors["normalizer.mean"], tensors["normalizer.scale"]
        noiseless = np.zeros((1, 0), np.float32)
        values = []
        for inputs in graph_inputs(tensors):
            images = {n.removeprefix("image."): a[None] for n, a in inputs.items() if n.startswith("image.")}
            noise = inputs["noise"][None] if "noise" in inputs else noiseless
            values.append(jax.device_put((inputs["observation"], noise, images)))

        def evaluate(observation: Array, noise: Array, images: Any) -> Array:
            return head.chunk(params, config, (observation - mean) * scale, noise, images)

        def nothing(observation: Array, noise: Array, images: Any) -> Array:
            return jnp.zeros(1)

        # the weights are constants of the program: XLA may prepare them as it likes
        real = jax.jit(evaluate).lower(*values[0]).compile()
        idle = jax.jit(nothing, keep_unused=True).lower(*values[0]).compile()
        current: list[Any] = [values[0], None]

        def prepare(i: int) -> None:
            current[0] = values[i]

        def run() -> None:
            current[1] = real(*current[0]).block_until_ready()

        self.prepare = prepare
        self.run = run
        self.call = lambda: idle(*current[0]).block_until_ready()
        self.chunk = lambda: np.asarray(current[1]).reshape(-1)


ENGINES = {"onnxruntime": OnnxRuntime, "openvino": OpenVino, "xla": Xla}


def graph_inputs(tensors: Tensors) -> list[Tensors]:
    """The inputs of each golden example as the graphs take them."""
    found: list[Tensors] = []
    for i, observation in enumerate(tensors["golden.observation"]):
        inputs = {"observation": observation[None]}
        for name, array in tensors.items():
            if name == "golden.noise" or name.startswith("golden.image."):
                inputs[name.removeprefix("golden.")] = array[i]
        found.append(inputs)
    return found


def aligned(array: Array) -> Array:
    """A copy on a cache line of its own, so that no engine has a reason to copy it again."""
    block = np.empty(array.nbytes + 64, np.uint8)
    begin = -block.ctypes.data % 64
    copy = block[begin : begin + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


def serve(engine: Engine, examples: int) -> None:
    """Answers orders until stdin ends."""
    turn = itertools.cycle(range(examples))

    def timed(work: Call) -> float:
        engine.prepare(next(turn))
        begin = time.perf_counter_ns()
        work()
        return (time.perf_counter_ns() - begin) / 1000.0

    gc.disable()
    print(json.dumps({"version": engine.version}), flush=True)
    for line in sys.stdin:
        order, n = line.split()[0], int(line.split()[1])
        answer: list[float]
        if order == "chunk":
            engine.prepare(n)
            engine.run()
            answer = [float(value) for value in engine.chunk()]
        else:
            work = {"run": engine.run, "call": engine.call}[order]
            for _ in range(max(1, n // 10)):
                timed(work)
            answer = [timed(work) for _ in range(n)]
        print(json.dumps(answer), flush=True)


def main() -> None:
    xla.configure()
    name, path = sys.argv[1], Path(sys.argv[2])
    tensors, texts = read_safetensors(path)
    serve(ENGINES[name](PolicyHeader.from_metadata(texts), tensors), len(tensors["golden.observation"]))


if __name__ == "__main__":
    main()
