"""`tandem bench policy`: what is counted, what is compared, and that the contenders compute the same."""

from __future__ import annotations

import dataclasses
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tandem.cli import bench_policy
from tandem.learner import networks
from tandem.learner.networks.mlp import init_mlp
from tandem.policy_bench import POLICIES, BenchPolicy, contenders, cost, engine, measure, report, weights
from tandem.policy_bench.contenders import Contender, PolicyBenchError, Running
from tandem.policy_bench.cost import Cost
from tandem.policy_bench.measure import Limits, Measured
from tandem.policy_file import PolicyHeader, named_arrays, read_safetensors
from tandem.run_folder import program

BY_NAME = {policy.name: policy for policy in POLICIES}
LIMITS = Limits("AVX2", gflops=100.0, gbytes_per_s=50.0)


def a_contender(name: str, kind: str, run_us: float, call_us: float = 0.0, error: float = 0.0) -> Measured:
    calls = [[call_us] * 10] if call_us else []
    return Measured(Contender(name, kind, []), {}, error, [[run_us] * 98 + [2 * run_us, 3 * run_us]], calls)


def small(name: str, **changes: Any) -> BenchPolicy:
    """One of the policies with a smaller config."""
    policy = BY_NAME[name]
    return dataclasses.replace(policy, config=policy.config | changes)


SEEING = small(
    "lerobot_act",
    model_size=16,
    heads=2,
    feedforward=24,
    encoder_layers=1,
    horizon=5,
    cameras=[{"name": "wrist", "height": 40, "width": 65}],
    backbone={"kind": "resnet18", "width": 4},
)
SMALL = [
    small("mlp_40_256x3_56", hidden=[24, 17], layer_norm=True, activation="gelu"),
    small("act_d128", model_size=24, heads=3, feedforward=40, encoder_layers=1, decoder_layers=2, horizon=5),
    SEEING,
    small("flow_512", hidden=[24, 17], steps=3),
    BY_NAME["best_of_8"],
]


# ---- figures


def test_the_ratio_is_ours_to_the_better_rival_without_what_a_call_costs() -> None:
    measured = [
        a_contender("Tandem AVX2", "tandem", 10.0),
        a_contender("Tandem scalar", "tandem", 100.0),
        a_contender("ONNX Runtime", "onnxruntime", 30.0, call_us=5.0),
        a_contender("OpenVINO", "openvino", 40.0, call_us=20.0),  # slower, but net faster
        a_contender("XLA", "xla", 12.0, call_us=5.0),  # no rival
        a_contender("Eigen", "eigen", 9.0),
    ]
    value = report.figures(POLICIES[0], Cost(1000, 1000, 1000), measured, LIMITS)
    assert (value["best_rival"], value["ratio"], value["target"]) == ("OpenVINO", 0.5, 0.5)
    assert value["reached"]
    measured[0].runs[0] = [10.2] * 100
    assert not report.figures(POLICIES[0], Cost(1000, 1000, 1000), measured, LIMITS)["reached"]


def test_percentiles_are_of_all_rounds_and_the_limit_is_the_slower_of_memory_and_arithmetic() -> None:
    ours, rival = a_contender("Tandem", "tandem", 10.0), a_contender("ONNX Runtime", "onnxruntime", 30.0)
    ours.runs.append([20.0] * 100)
    value = report.figures(POLICIES[0], Cost(400_000, 500_000, 800_000), [ours, rival], LIMITS)
    assert (value["memory_limit_us"], value["compute_limit_us"]) == pytest.approx((10.0, 8.0))
    row = value["contenders"][0]
    assert value["limit_us"] == value["memory_limit_us"]
    assert (row["min_us"], row["max_us"], row["runs"]) == (10.0, 30.0, 200)
    assert row["round_p50_us"] == [10.0, 20.0]
    assert row["p50_us"] == pytest.approx(20.0) and row["of_limit"] == pytest.approx(2.0)
    assert 20.0 <= row["p99_us"] <= 30.0


@pytest.mark.parametrize("error", [2e-4, math.nan])
def test_a_contender_that_computes_something_else_is_named(error: float) -> None:
    rivals = [
        a_contender("OpenVINO", "openvino", 3.0, error=error),
        a_contender("Eigen", "eigen", 1.0, error=9e-5),
    ]
    value = report.figures(
        POLICIES[0], Cost(1, 1, 1), [a_contender("Tandem", "tandem", 1.0), *rivals], LIMITS
    )
    (phrase,) = report.wrong([value])
    assert phrase.startswith("OpenVINO is ") and POLICIES[0].name in phrase


def test_figures_are_shown_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    measured = [a_contender("Tandem AVX2", "tandem", 9.0), a_contender("ONNX Runtime", "onnxruntime", 30.0)]
    values = [report.figures(policy, cost.of(policy), measured, LIMITS) for policy in POLICIES]
    bench_policy.show(values[0])
    bench_policy.show_targets(values)
    assert "0.300 x ONNX Runtime (target: 0.5)" in capsys.readouterr().out
    bench_policy.draw(tmp_path / "plot.png", values)
    assert (tmp_path / "plot.png").stat().st_size > 10_000


# ---- costs


def test_a_resnet18_costs_what_everybody_says() -> None:
    total, pixels = cost.resnet18(64, 224, 224)
    assert total.flops == pytest.approx(2 * 1.8136e9, rel=1e-3)  # torchvision: 1.814 G with its classifier
    assert total.weights == pytest.approx(4 * 11.167e6, rel=1e-3)
    assert pixels == 49


def test_a_flow_reads_its_field_once_a_step_and_the_observation_once() -> None:
    flow = cost.of(BY_NAME["flow_512"])
    step = 56 * 512 + 512 * 512 * 2 + 512 * 56
    assert flow == Cost(4 * (40 * 512 + step), 4 * (40 * 512 + 10 * step), 2 * (40 * 512 + 10 * step))


def test_samples_share_the_weights_but_not_the_arithmetic() -> None:
    one, eight = (cost.flow(BY_NAME["flow_512"].config, 40, 7, n) for n in (1, 8))
    assert one.read == eight.read and 7 < eight.flops / one.flops < 8


def test_an_act_does_not_pay_for_what_is_constant() -> None:
    config = BY_NAME["act_d128"].config
    one, two = (cost.act(config | {"decoder_layers": n}, 7) for n in (1, 2))
    feedforward = 2 * 4 * 128 * 512
    assert two.weights - one.weights == 4 * 8 * 128 * 128 + feedforward
    assert one.weights == 4 * (40 * 128 + 2 * 4 * 128 * 128 + 3 * 128 * 128 + 128 * 7) + 3 * feedforward


# ---- weights


def test_a_policy_is_the_same_in_every_run(tmp_path: Path) -> None:
    for name in ("a", "b"):
        weights.write(tmp_path / name, SMALL[3])
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_parameters_come_back_from_their_names() -> None:
    params = {
        "layers": init_mlp(np.random.default_rng(0), [3] * 13, True, 1.0),
        "norm": {"scale": np.ones(3)},
    }
    back = weights.tree(named_arrays(params))
    assert len(back["layers"]) == 12 and set(back) == {"layers", "norm"}
    for index, layer in enumerate(params["layers"]):
        np.testing.assert_array_equal(back["layers"][index]["weight"], layer["weight"])


@pytest.mark.parametrize("policy", POLICIES, ids=lambda policy: policy.name)
def test_every_policy_is_one_that_the_learner_knows(policy: BenchPolicy) -> None:
    config = networks.read_config(policy.architecture, policy.config)
    assert config.model_dump(mode="json") == policy.config


# ---- contenders


@pytest.mark.parametrize("policy", SMALL, ids=lambda policy: policy.name)
def test_eigen_computes_what_the_golden_examples_say(tmp_path: Path, policy: BenchPolicy) -> None:
    file = tmp_path / "policy.safetensors"
    weights.write(file, policy)
    golden = read_safetensors(file)[0]["golden.chunk"]
    assert golden.std() > 0.05, "the network is too tame to test anything"
    eigen = Contender("Eigen", "eigen", [program("tandem_bench_eigen_baseline")])
    with Running(eigen, file, core=measure_core()) as running:
        assert measure.parity(running, golden) < 1e-5
        times = running.ask("run", 7)
        assert len(times) == 7 and min(times) > 0.0


def test_xla_is_given_the_weights_and_inputs_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "policy.safetensors"
    weights.write(file, SEEING)
    tensors, texts = read_safetensors(file)
    xla = engine.Xla(PolicyHeader.from_metadata(texts), tensors)
    for i, chunk in enumerate(tensors["golden.chunk"]):
        xla.prepare(i)
        xla.run()
        np.testing.assert_allclose(xla.chunk(), chunk.reshape(-1), atol=1e-5)


def measure_core() -> int:
    from tandem.loop_bench import cores

    return cores(-1)[0]


def test_ours_tells_its_kernels_and_its_parity(tmp_path: Path) -> None:
    file = tmp_path / "policy.safetensors"
    weights.write(file, SMALL[0])
    golden = read_safetensors(file)[0]["golden.chunk"]
    everyone = contenders.field_of(flops=1)
    assert everyone[-1].kind == "eigen" and [c.kind for c in everyone].count("tandem") >= 2
    assert "scalar" not in " ".join(c.name for c in contenders.field_of(flops=10**9))
    scalar = next(each for each in everyone if each.name == "Tandem scalar")
    with Running(scalar, file, measure_core()) as running:
        assert running.about["kernel"] == "scalar"
        assert measure.parity(running, golden) < 1e-5


def test_a_contender_that_dies_is_named_with_its_last_words(tmp_path: Path) -> None:
    words = "import sys; print('{}', flush=True); input(); sys.exit('out of luck')"
    with (
        Running(Contender("Peer", "xla", [sys.executable, "-c", words]), tmp_path, measure_core()) as running,
        pytest.raises(PolicyBenchError, match="Peer ended with 1: out of luck"),
    ):
        running.ask("run", 1)


def test_machine_limits_are_given_for_every_size() -> None:
    found = contenders.machine_limits([1000, 10_000_000], measure_core())
    assert found["gflops"] > 0.1 and set(found["gbytes_per_s"]) == {"1000", "10000000"}
    assert min(found["gbytes_per_s"].values()) > 0.01


def test_blocks_are_short_but_never_empty() -> None:
    assert [measure.block(us) for us in (1.0, 2000.0, 1e7)] == [measure.MOST_RUNS, 100, 1]


def test_arrays_are_copied_to_a_cache_line_of_their_own() -> None:
    copy = engine.aligned(np.arange(35, dtype=np.uint8).reshape(5, 7))
    assert copy.ctypes.data % 64 == 0
    np.testing.assert_array_equal(copy, np.arange(35).reshape(5, 7))
