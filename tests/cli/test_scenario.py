"""Composition, overrides and the origin of every value."""

from pathlib import Path
from typing import Any

import pytest

from tandem.scenario import Scenario, ScenarioError, compose, load, observed


def composed(config: Path, *overrides: str, **run: Any) -> Scenario:
    return compose(config, "peg", "tandem", run, overrides)


def refusal(config: Path, *overrides: str, **run: Any) -> str:
    with pytest.raises(ScenarioError) as error:
        composed(config, *overrides, **run)
    return str(error.value)


def test_files_become_sections_in_order(config: Path) -> None:
    scenario = composed(config, seed=3)
    assert list(scenario.data) == ["run", "task", "controller", "operator", "method"]
    assert scenario.data["controller"]["stiffness"]["translation"] == [2000, 2000, 2000]
    assert scenario.run["seed"] == 3
    assert str(scenario.origins["task.policy_rate_hz"]) == "config/tasks/peg.yaml:3"
    assert str(scenario.origins["controller.stiffness.rotation"]) == "config/controller.yaml:3"


def test_written_scenario_reads_back_equal(config: Path, tmp_path: Path) -> None:
    scenario = composed(config, "controller.clip=2e-3")
    scenario.write(tmp_path / "scenario.yaml")
    again = load(tmp_path / "scenario.yaml")
    assert again.data == scenario.data
    assert scenario.first_difference(again) is None
    assert again.data["controller"]["clip"] == 0.002


def test_numbers_with_exponents_are_numbers_and_words_stay_words(config: Path) -> None:
    assert composed(config).data["controller"]["clip"] == 0.01
    assert composed(config, "run.policy=on").run["policy"] == "on"


def test_overrides_are_typed_by_yaml(config: Path) -> None:
    scenario = composed(
        config, "run.env_steps=400", "controller.stiffness.rotation=[1, 2, 3]", "operator.skilled=false"
    )
    assert scenario.run["env_steps"] == 400
    assert scenario.data["controller"]["stiffness"]["rotation"] == [1, 2, 3]
    assert scenario.data["operator"]["skilled"] is False


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        (
            "controler.clip=1",
            "--set controler.clip=1: there is no key controler.clip;"
            " the nearest is controller.clip (config/controller.yaml:4).",
        ),
        ("run.env_stepz=1", "the nearest is run.env_steps (config/run.yaml:7)"),
        ("run.translation=1", "the nearest is controller.stiffness.translation (config/controller.yaml:2)"),
        ("controller.stiffness=3", "is a section (config/controller.yaml:1); set one of its keys"),
        (
            "controller.clip=soft",
            "controller.clip is a text; it must be a number like 0.01 (config/controller.yaml:4)",
        ),
        ("operator.skilled=1", "is a number; it must be a truth value like true"),
        ("run.env_steps", "it must read key=value"),
        ("run.env_steps=[1", "the value is not YAML"),
    ],
)
def test_wrong_override_is_refused_with_the_way_out(config: Path, override: str, sentence: str) -> None:
    assert sentence in refusal(config, override)


def test_run_values_out_of_range_name_place_value_and_range(config: Path) -> None:
    assert refusal(config, "run.learner_lag=11") == (
        "--set run.learner_lag=11: run.learner_lag is 11; it must be a whole number in [0, 10]."
    )
    (config / "run.yaml").write_text(
        (config / "run.yaml").read_text().replace("env_steps: 60", "env_steps: 0")
    )
    assert refusal(config).startswith(
        "config/run.yaml:7: run.env_steps is 0; it must be a whole number in [1, "
    )


def test_seeds_of_evaluations_are_refused_for_training(config: Path) -> None:
    assert refusal(config, seed=1_000_000).startswith(
        "--seed: run.seed is 1000000; it must be a whole number in [0, 999999]"
    )


def test_unknown_names_are_refused_with_the_nearest(config: Path) -> None:
    with pytest.raises(
        ScenarioError, match=r"no method 'tandm'; there are: mcbc, tandem. Did you mean tandem\?"
    ):
        compose(config, "peg", "tandm", {})
    (config / "run.yaml").write_text((config / "run.yaml").read_text() + "learner_lagg: 2\n")
    assert (
        refusal(config) == "config/run.yaml:19: there is no key run.learner_lagg; the nearest is learner_lag."
    )


def test_broken_files_are_refused_with_their_line(config: Path) -> None:
    (config / "operator.yaml").write_text("a: 1\nb: [2\n")
    assert refusal(config).startswith("config/operator.yaml:")
    (config / "operator.yaml").write_text("a: 1\nb: 2\na: 3\n")
    assert refusal(config) == "config/operator.yaml:3: a is given twice, first in line 1."
    (config / "operator.yaml").write_text("- 1\n")
    assert refusal(config) == "config/operator.yaml: it must hold keys and values, but holds a list."


def test_errors_of_other_programs_point_to_the_line_that_a_person_wrote(config: Path) -> None:
    scenario = composed(config, "controller.clip=9")
    lines = scenario.dumps().splitlines()
    rate = next(i for i, line in enumerate(lines, 1) if "policy_rate_hz" in line)
    clip = next(i for i, line in enumerate(lines, 1) if "clip" in line)
    error = f"/tmp/runs/x/scenario.yaml:{rate}: task.policy_rate_hz is 0; it must be in [1, 200]."
    assert (
        scenario.explain(error)
        == "config/tasks/peg.yaml:3: task.policy_rate_hz is 0; it must be in [1, 200]."
    )
    short = f"runs/x/scenario.yaml:{rate}: policy_rate_hz is 0; it must be in [1, 200]."
    assert scenario.explain(short) == "config/tasks/peg.yaml:3: policy_rate_hz is 0; it must be in [1, 200]."
    assert (
        scenario.explain(f"scenario.yaml:{clip}: controller.clip is 9.")
        == "--set controller.clip=9: controller.clip is 9."
    )
    assert scenario.explain("scenario.yaml:999: strange") == "scenario.yaml:999: strange"


def test_first_difference_names_key_and_both_values(config: Path) -> None:
    one, other = composed(config), composed(config, "controller.clip=0.5", "method.discount=0.9")
    assert one.first_difference(other) == "controller.clip is 0.01 here and 0.5 there"
    other = composed(config)
    del other.data["method"]["learner"]["batch"]
    other.data["method"]["learner"]["size"] = 1
    assert one.first_difference(other) == "method.learner.batch is 256 here and absent there"


def test_a_method_is_the_common_file_with_its_own_lines_laid_over(config: Path) -> None:
    scenario = composed(config)
    learner = scenario.data["method"]["learner"]
    assert scenario.data["method"]["name"] == "tandem"
    assert learner == {"batch": 256, "head": {"kind": "flow"}}
    assert str(scenario.origins["method.learner.head.kind"]) == "config/methods/tandem.yaml:3"
    assert str(scenario.origins["method.name"]) == "config/methods/tandem.yaml:1"
    assert str(scenario.origins["method.learner.batch"]) == "config/method.yaml:4"
    mcbc = compose(config, "peg", "mcbc", {})
    assert mcbc.data["method"]["learner"]["head"]["kind"] == "mlp"
    assert str(mcbc.origins["method.learner.head.kind"]) == "config/method.yaml:6"


@pytest.mark.parametrize(
    ("lines", "sentence"),
    [
        (
            "name: tandem\nlearner:\n  batsh: 1\n",
            "config/methods/tandem.yaml:3: there is no key method.learner.batsh; the nearest is method.learner.batch.",
        ),
        (
            "name: tandem\nhorizont: 4\n",
            "config/methods/tandem.yaml:2: there is no key method.horizont; the nearest is method.horizon.",
        ),
        ("horizon: 4\n", "config/methods/tandem.yaml: name is missing; it must be tandem."),
    ],
)
def test_a_method_file_may_not_say_what_the_common_file_does_not(
    config: Path, lines: str, sentence: str
) -> None:
    (config / "methods" / "tandem.yaml").write_text(lines)
    assert refusal(config) == sentence


def test_an_error_in_a_methods_own_line_points_to_it(config: Path) -> None:
    scenario = composed(config)
    kind = next(i for i, line in enumerate(scenario.dumps().splitlines(), 1) if "kind: flow" in line)
    text = f"/tmp/x/scenario.yaml:{kind}: method.learner.head.kind is 'flow'; it must be mlp."
    assert scenario.explain(text).startswith("config/methods/tandem.yaml:3: method.learner.head.kind")


def with_defaults(config: Path, lines: str) -> None:
    file = config / "tasks" / "peg.yaml"
    file.write_text(file.read_text() + "defaults:\n" + lines)


def test_a_task_may_ask_for_other_values_of_run_and_method(config: Path) -> None:
    with_defaults(config, "  run: {env_steps: 77}\n  method: {learner: {batch: 12}}\n")
    scenario = composed(config)
    assert scenario.run["env_steps"] == 77
    assert scenario.data["method"]["learner"]["batch"] == 12
    assert str(scenario.origins["method.learner.batch"]).startswith("config/tasks/peg.yaml:")
    assert "defaults" not in scenario.data["task"]
    assert composed(config, "run.env_steps=5").run["env_steps"] == 5


def test_defaults_of_a_task_stay_with_keys_that_exist(config: Path) -> None:
    with_defaults(config, "  method: {batsh: 12}\n")
    assert "there is no key method.batsh" in refusal(config)


def test_defaults_of_a_task_are_of_run_and_method_alone(config: Path) -> None:
    with_defaults(config, "  controller: {clip: 1}\n")
    assert "defaults of a task must be a mapping with the keys run and method" in refusal(config)


def test_policy_that_sees_is_not_told_where_things_are() -> None:
    terms = ["tool_z", "force_x", "object_x", "goal_fine_rz", "gripper"]
    assert observed("state", terms) == terms
    assert observed("image", terms) == ["tool_z", "force_x", "gripper"]
