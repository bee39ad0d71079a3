"""Scenarios: what is wrong is said in one sentence with file, line, value and limit."""

from __future__ import annotations

import pytest
import support
import yaml

from tandem.learner.config import check_method, load_scenario
from tandem.scenario import ScenarioError

NAMES = sorted(path.stem for path in support.METHODS.glob("*.yaml"))


def load(tmp_path, data):
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return load_scenario(path)


@pytest.mark.parametrize("name", NAMES)
def test_every_method_file_is_valid_and_named_as_its_file(name):
    assert check_method(yaml.safe_load((support.METHODS / f"{name}.yaml").read_text())).name == name


def test_all_methods_have_the_same_update_ratio():
    methods = [check_method(yaml.safe_load((support.METHODS / f"{name}.yaml").read_text())) for name in NAMES]
    assert len({method.learner.updates_per_env_step for method in methods}) == 1


METHOD, LEARNER = "method", "method.learner"


@pytest.mark.parametrize(
    ("section", "change", "sentence"),
    [
        (LEARNER, {"batch": 0}, r"scenario.yaml:\d+: method.learner.batch is 0; it must be in \[1, 65536\]"),
        (LEARNER, {"learning_rate": float("nan")}, r"method.learner.learning_rate is nan"),
        (LEARNER, {"ema": None}, r"method.learner.ema is missing"),
        (LEARNER, {"bach": 3}, r"no key method.learner.bach; the nearest is method.learner.batch"),
        (LEARNER + ".head", {"hidden": [128, 0]}, r"head.hidden.1 is 0; it must be in \[1, 4096\]"),
        (LEARNER + ".head", {"kind": "act"}, r"method.learner.head.kind is 'act'; input should be 'mlp'"),
        (LEARNER + ".critic", {"kind": "none"}, r"critic.kind is none; improvement max_q"),
        (METHOD, {"discount": 1.5}, r"scenario.yaml:\d+: method.discount is 1.5; it must be in \(0, 1\]"),
        (METHOD + ".execution", {"mode": "ensemble"}, r"execution.mode is 'ensemble'; .*temporal_ensembling"),
        (METHOD + ".execution", {"ensemble_decay": -0.1}, r"ensemble_decay is -0.1; it must be in \[0, 10\]"),
        (METHOD + ".execution", {"latency_ticks": None}, r"execution.latency_ticks is missing"),
        (METHOD + ".execution", {"execute": 2}, r"execute is 2; it must be in \[1, horizon\] = \[1, 1\]"),
        ("task", {"action_axes": ["rz", "x"]}, r"must be in wire order"),
    ],
)
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


def test_fingerprint_ignores_what_does_not_change_learning(tmp_path):
    base = support.scenario()
    assert support.scenario(checkpoint_every_s=60).fingerprint() == base.fingerprint()
    assert support.scenario(env_steps=999).fingerprint() == base.fingerprint()
    assert support.scenario(batch=17).fingerprint() != base.fingerprint()
