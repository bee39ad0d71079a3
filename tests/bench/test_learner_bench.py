"""What `bench learner` reports, and that both contenders are given the same, whole work."""

from pathlib import Path

import numpy as np
import pytest

from tandem import run_folder, scenario
from tandem.cli.bench_learner import report
from tandem.learner.config import LearnerScenario, load_scenario
from tandem.learner_bench import work


def setting(folder: Path, method: str) -> LearnerScenario:
    file = folder / f"{method}.yaml"
    scenario.compose(run_folder.CONFIG, "peg", method, {}).write(file)
    return load_scenario(file)


def test_operations_are_those_of_the_matrix_products(tmp_path: Path) -> None:
    # 23 observations + 4 x 4 actions; forward, and twice backward but for the first layer's inputs
    critic = 2 * 256 * (2 * 39 * 128 + 3 * 128 * 128 + 3 * 128)
    field = 2 * 256 * (2 * (39 + 8) * 256 + 3 * 256 * 256 + 3 * 256 * 16)
    assert work.flops(setting(tmp_path, "tandem")) == 5 * critic + field


def test_work_file_holds_every_parameter_and_whole_rows(tmp_path: Path) -> None:
    work.write(tmp_path / "work.npz", setting(tmp_path, "tandem"))
    given = np.load(tmp_path / "work.npz")
    assert given["critic.0.weight"].shape == (5, 128, 39) and given["critic.1.norm_scale"].shape == (5, 128)
    assert given["critic.2.weight"].shape == (5, 1, 128) and "critic.3.weight" not in given
    assert given["actor.0.weight"].shape == (256, 47) and given["actor.2.weight"].shape == (16, 256)
    assert given["rows.chunk"].shape == (work.N_ROWS, 4, 4) and given["noise"].shape == (256, 4, 4)


def test_a_method_that_the_peer_cannot_do_is_refused(tmp_path: Path) -> None:
    with pytest.raises(work.WorkError, match="mlp, mc, max_q"):
        work.write(tmp_path / "work.npz", setting(tmp_path, "mcbc"))


def test_report_pairs_the_contenders_round_by_round() -> None:
    turns = [
        {"updates_per_s": 100.0, "torch_updates_per_s": 50.0},
        {"updates_per_s": 40.0, "torch_updates_per_s": 10.0},  # the machine was busy: both are slow
        {"updates_per_s": 120.0, "torch_updates_per_s": 40.0},
    ]
    value = report(turns, flops=200_000_000, gflops=80.0)
    assert (value["updates_per_s"], value["torch_updates_per_s"], value["ratio"]) == (100.0, 40.0, 3.0)
    assert value["limit_updates_per_s"] == 400.0
