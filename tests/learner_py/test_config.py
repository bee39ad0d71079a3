"""Scenarios: what is wrong is said in one sentence with file, line, value and limit."""

from __future__ import annotations

import pytest
import support
import yaml

from tandem.learner.config import check_method, load_scenario
from tandem.scenario import ScenarioError, compose


def load(tmp_path, data):
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return load_scenario(path)


def method_of(name):
    return check_method(compose(support.CONFIG, "peg", name, {}).data["method"])


@pytest.mark.parametrize("name", support.METHODS)
def test_every_method_file_is_valid_and_named_as_its_file(name):
    assert method_of(name).name == name


def test_all_methods_have_the_same_update_ratio():
    """That of the paper's Algorithm 1."""
    assert {method_of(name).learner.updates_per_env_step for name in support.METHODS} == {1}


METHOD, LEARNER = "method", "method.learner"


@pytest.mark.parametrize(
    ("section", "change", "sentence"),
    [
        (LEARNER + ".replay", {"batch": 0}, r"scenario.yaml:\d+: .*replay.batch is 0; it must be in \[1, 65536\]"),
        (LEARNER, {"learning_rate": float("nan")}, r"method.learner.learning_rate is nan"),
        (LEARNER, {"ema": None}, r"method.learner.ema is missing"),
        (LEARNER + ".replay", {"bach": 3}, r"no key method.learner.replay.bach; .* method.learner.replay.batch"),
        (LEARNER + ".head.mlp", {"hidden": [128, 0]}, r"mlp.hidden.1 is 0; it must be in \[1, 4096\]"),
        (LEARNER + ".head", {"kind": "cnn"}, r"method.learner.head.kind is 'cnn'; input should be 'mlp'"),
        (METHOD, {"discount": 1.5}, r"scenario.yaml:\d+: method.discount is 1.5; it must be in \(0, 1\]"),
        (METHOD + ".execution", {"mode": "ensemble"}, r"execution.mode is 'ensemble'; .*temporal_ensembling"),
        (METHOD + ".execution", {"ensemble_decay": -11.0}, r"ensemble_decay is -11(.0)?; it must be in \[-10, 10\]"),
        (METHOD + ".execution", {"latency_ticks": None}, r"execution.latency_ticks is missing"),
        ("task", {"action_axes": ["rz", "x"]}, r"must be in wire order"),
    ],
)  # fmt: skip
def test_bad_value_is_named_with_its_place_and_limit(tmp_path, section, change, sentence):
    data = support.scenario_data()
    node = data
    for part in section.split("."):
        node = node[part]
    for key, value in change.items():
        node[key] = value
        if value is None:
            del node[key]
    with pytest.raises(ScenarioError, match=sentence):
        load(tmp_path, data)


def cut_down(**changes):
    return {"improvement": {"kind": "imitate"}, **changes}


@pytest.mark.parametrize(
    ("learner", "sentence"),
    [
        ({"critic": {"kind": "none"}}, r"critic.kind is none; improvement max_q asks a critic; choose mc, td or iql"),
        (
            cut_down(critic={"kind": "none"}, decision={"kind": "best_of_n"}),
            r"critic.kind is none; decision best_of_n asks a critic",
        ),
        ({"improvement": {"data": "human"}}, r"improvement.data is human; max_q learns from all data"),
        ({"improvement": {"kind": "sac"}}, r"head.kind is mlp; sac needs its log-density: choose gaussian"),
        ({"improvement": {"kind": "e2hil"}, "head": {"kind": "flow"}}, r"head.kind is flow; e2hil needs"),
        ({"improvement": {"kind": "expo"}}, r"decision.kind is head; expo decides between .*: choose best_of_n"),
        ({"critic": {"kind": "td", "td": {"subset": 3}}}, r"td.subset is 3; there are 2 critics"),
        ({"decision": {"with_reference": True}}, r"with_reference is true; it is for best_of_n"),
        (
            {"decision": {"kind": "best_of_n", "samples": 129, "with_reference": True}},
            r"decision.samples is 129, and .* as many more; there may be 256 together",
        ),
        (
            {"improvement": {"e2hil": {"low_quantile": 0.9}}},
            r"low_quantile is 0.9; it must be less than high_quantile = 0.9",
        ),
        ({"head": {"gaussian": {"log_std_min": 3.0}}}, r"head.gaussian.log_std_min is 3.0; .* log_std_max = 2.0"),
        ({"gripper": {"kind": "critic"}}, r"gripper.kind is critic, critic.kind mc, horizon 1; .* td and 1"),
        (
            cut_down(
                gripper={"kind": "critic"}, decision={"kind": "best_of_n"}, critic={"kind": "td", "td": {"steps": 1}}
            ),
            r"decision.kind is best_of_n; beside a gripper's critic it must be head",
        ),
        ({"improvement": {"edit": {"log_std_max": -6.0}}}, r"edit.log_std_min is -5.0; .* log_std_max = -6.0"),
    ],
)  # fmt: skip
def test_choices_that_do_not_fit_together_are_refused(tmp_path, learner, sentence):
    with pytest.raises(ScenarioError, match=sentence):
        load(tmp_path, support.scenario_data(**learner))


def test_chunks_are_not_executed_beyond_their_end_nor_valued_by_fewer_rewards_than_they_earn(tmp_path):
    data = support.scenario_data()
    data["method"]["execution"]["execute"] = 2
    with pytest.raises(ScenarioError, match=r"execute is 2; it must be in \[1, horizon\] = \[1, 1\]"):
        load(tmp_path, data)
    for kind in ("td", "iql"):
        data = support.scenario_data(horizon=4, critic={"kind": kind, "td": {"steps": 3}})
        with pytest.raises(ScenarioError, match=r"td.steps is 3; it must not be less than the horizon of 4"):
            load(tmp_path, data)


def test_critic_of_the_gripper_needs_to_see_what_the_hand_was_told(tmp_path):
    data = support.scenario_data(method="hil_serl")
    data["task"]["observation"] = ["a", "b", "c"]
    with pytest.raises(ScenarioError, match=r"task.observation lacks gripper_commanded"):
        load(tmp_path, data)
    data["task"]["action_axes"] = ["x", "rz"]  # nothing to decide
    load(tmp_path, data)


def test_fingerprint_ignores_what_does_not_change_learning():
    base = support.scenario()
    assert support.scenario(checkpoint_every_s=60).fingerprint() == base.fingerprint()
    assert support.scenario(env_steps=999).fingerprint() == base.fingerprint()
    assert support.scenario(replay={"batch": 17}).fingerprint() != base.fingerprint()
    assert support.scenario(decision={"kind": "best_of_n"}).fingerprint() != base.fingerprint()
