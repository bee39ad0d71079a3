"""The figures of `tandem bench policy` out of what was measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from tandem.policy_bench.cost import Cost
from tandem.policy_bench.measure import Limits, Measured
from tandem.policy_bench.policies import BenchPolicy

RIVALS = ("onnxruntime", "openvino")
PARITY = 1e-4  # action units; beyond it a contender computes something else


def figures(policy: BenchPolicy, cost: Cost, measured: list[Measured], limits: Limits) -> dict[str, Any]:
    """One policy. The first contender is ours with the kernel that it chooses itself: the one that has a target.

    net_p50_us: without a call that computes nothing. ratio: ours to the better net rival.
    """
    memory_us = cost.read / limits.gbytes_per_s / 1e3
    compute_us = cost.flops / limits.gflops / 1e3
    limit_us = max(memory_us, compute_us)
    rows = [_row(each, limit_us) for each in measured]
    best = min((row for row in rows if row["kind"] in RIVALS), key=lambda row: row["net_p50_us"])
    ratio = rows[0]["net_p50_us"] / best["net_p50_us"]
    return {
        "policy": policy.name,
        "description": policy.description,
        "weights_bytes": cost.weights,
        "read_bytes": cost.read,
        "flops": cost.flops,
        "limit_us": limit_us,
        "memory_limit_us": memory_us,
        "compute_limit_us": compute_us,
        "gbytes_per_s": limits.gbytes_per_s,
        "gflops": limits.gflops,
        "instruction_set": limits.instruction_set,
        "contenders": rows,
        "best_rival": best["name"],
        "ratio": ratio,
        "target": policy.target,
        "reached": ratio <= policy.target,
    }


def wrong(policies: list[dict[str, Any]]) -> list[str]:
    """A phrase for each contender that does not compute what JAX does."""
    return [
        f"{row['name']} is {row['parity_error']:.1e} off JAX on {each['policy']}"
        for each in policies
        for row in each["contenders"]
        if not row["parity_error"] <= PARITY
    ]


def _row(measured: Measured, limit_us: float) -> dict[str, Any]:
    runs = np.concatenate(measured.runs)
    p50, p99 = np.percentile(runs, [50, 99])
    call = float(np.median(np.concatenate(measured.calls))) if measured.calls else 0.0
    return {
        "name": measured.contender.name,
        "kind": measured.contender.kind,
        **measured.about,
        "runs": len(runs),
        "min_us": float(runs.min()),
        "p50_us": float(p50),
        "p99_us": float(p99),
        "max_us": float(runs.max()),
        "call_p50_us": call,
        "net_p50_us": float(p50) - call,
        "of_limit": (float(p50) - call) / limit_us,
        "parity_error": measured.error,
        "round_p50_us": [float(np.median(each)) for each in measured.runs],
    }
