"""The contenders of `tandem bench policy`: child processes on one core that evaluate the same policy file in turns.

Each answers orders on its stdin; see bench/policy/contender.h and engine.py. They end when their stdin does.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from tandem.processes import missing_program
from tandem.run_folder import program

PEERS = {"ONNX Runtime": "onnxruntime", "OpenVINO": "openvino", "XLA": "xla"}
SLOW_KERNEL = "scalar"  # the reference; left out where it would take longer than a second or so
SLOW_KERNEL_FLOPS = 2e8


class PolicyBenchError(Exception):
    """A sentence: what could not be measured and why."""


@dataclass(frozen=True)
class Contender:
    name: str
    kind: str  # tandem, onnxruntime, openvino, xla, eigen
    command: list[str | Path]  # without the policy file
    environment: dict[str, str] = field(default_factory=dict)


def field_of(flops: int) -> list[Contender]:
    """Everyone who evaluates a policy of so many operations; ours first, the kernel that it chooses itself in front."""
    ours = program("tandem_bench_policy")
    eigen = program(f"tandem_bench_eigen_{eigen_instructions()}")
    for each in (ours, eigen):
        if sentence := missing_program([each]):
            raise PolicyBenchError(sentence)
    kernels = _ask([ours, "--kernels"])
    if flops > SLOW_KERNEL_FLOPS:
        kernels = [kernel for kernel in kernels if kernel != SLOW_KERNEL]
    found = [Contender(f"Tandem {k}", "tandem", [ours], {"TANDEM_KERNEL": k}) for k in kernels]
    for name, engine in PEERS.items():
        found.append(Contender(name, engine, [sys.executable, "-m", "tandem.policy_bench.engine", engine]))
    found.append(Contender("Eigen", "eigen", [eigen]))
    return found


def eigen_instructions() -> str:
    """The best build of the Eigen contender that this machine runs."""
    words = Path("/proc/cpuinfo").read_text().split()
    if {"avx512f", "avx512dq", "avx512vl", "avx512bw"} <= set(words):
        return "avx512"
    return "avx2" if {"avx2", "fma"} <= set(words) else "baseline"


def machine_limits(sizes: list[int], core: int) -> dict[str, Any]:
    """instruction_set, gflops and gbytes_per_s by size of the working set in bytes; see machine_limits.cpp."""
    return dict(_ask([*_pinned(core), program("tandem_machine_limits"), *map(str, sizes)]))


class Running:
    """A contender at work on one policy file, as a context."""

    def __init__(self, contender: Contender, policy: Path, core: int) -> None:
        self.contender = contender
        with ExitStack() as stack:
            self._errors = stack.enter_context(tempfile.TemporaryFile("w+"))
            self._process = stack.enter_context(
                subprocess.Popen(
                    [*_pinned(core), *contender.command, policy],
                    env=os.environ | contender.environment,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=self._errors,
                    text=True,
                )
            )
            stack.callback(self._process.kill)
            self.about: dict[str, Any] = self._answer()
            self._stack = stack.pop_all()

    def ask(self, order: str, n: int) -> list[float]:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(f"{order} {n}\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # it is dead; what it said last tells why
        return list(self._answer())

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if line:
            return json.loads(line)
        self._process.wait()
        self._errors.seek(0)
        said = self._errors.read().strip().splitlines() or ["it said nothing"]
        raise PolicyBenchError(f"{self.contender.name} ended with {self._process.returncode}: {said[-1]}")

    def __enter__(self) -> Running:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()


def _pinned(core: int) -> list[str | Path]:
    return ["taskset", "--cpu-list", str(core)]


def _ask(command: list[str | Path]) -> Any:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise PolicyBenchError(f"{command[0]} ended with {done.returncode}: {done.stderr.strip()}")
    return json.loads(done.stdout)
