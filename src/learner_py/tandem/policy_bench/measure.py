"""One policy's rounds: every contender in turn on one core, a short block each, so that drift of the machine hits
all alike."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tandem.policy_bench.contenders import Contender, Running, machine_limits
from tandem.policy_bench.cost import Cost
from tandem.policy_file import read_safetensors

BLOCK_US = 200_000.0  # of one contender in one round
MOST_RUNS = 1000  # in a block
MOST_CALLS = 200


@dataclass
class Measured:
    """What one contender did. Times in us, one list a round."""

    contender: Contender
    about: dict[str, Any]  # what it says of itself
    error: float  # largest difference of an example's chunk from JAX's, in action units
    runs: list[list[float]] = field(default_factory=list)
    calls: list[list[float]] = field(default_factory=list)  # that compute nothing; none of a C++ program


@dataclass
class Limits:
    """What the machine can do at best on one core, for the policy's working set."""

    instruction_set: str
    gflops: float
    gbytes_per_s: float


def measure(
    policy: Path, contenders: list[Contender], cost: Cost, rounds: int, core: int
) -> tuple[list[Measured], Limits]:
    golden = read_safetensors(policy)[0]["golden.chunk"]
    before = machine_limits([cost.weights], core)
    with ExitStack() as stack:
        running = [stack.enter_context(Running(each, policy, core)) for each in contenders]
        found = [Measured(each.contender, each.about, parity(each, golden)) for each in running]
        sizes = [block(min(each.ask("run", 2))) for each in running]
        for turn in range(rounds):
            order = [(turn + i) % len(running) for i in range(len(running))]  # nobody is always last
            for i in order:
                found[i].runs.append(running[i].ask("run", sizes[i]))
                if running[i].contender.kind not in ("tandem", "eigen"):
                    found[i].calls.append(running[i].ask("call", min(sizes[i], MOST_CALLS)))
    after = machine_limits([cost.weights], core)
    size = str(cost.weights)
    return found, Limits(
        before["instruction_set"],
        max(before["gflops"], after["gflops"]),
        max(before["gbytes_per_s"][size], after["gbytes_per_s"][size]),
    )


def parity(running: Running, golden: np.ndarray) -> float:
    """golden: JAX's chunks (N, h, A)."""
    chunks = np.array([running.ask("chunk", i) for i in range(len(golden))])
    return float(np.abs(chunks - golden.reshape(len(golden), -1)).max())


def block(one_us: float) -> int:
    """Runs in a block when one takes so long."""
    return int(np.clip(BLOCK_US / one_us, 1, MOST_RUNS))
