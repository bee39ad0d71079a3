"""Ablation files: what they may hold, what they become, and that those that we ship hold together."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from tandem.cli.app import app
from tandem.experiments import ablation
from tandem.experiments.runs import check, typed
from tandem.run_folder import CONFIG, RunFolder
from tandem.scenario import ScenarioError

FILE = """\
title: Batches
question: How large?
task: peg
method: tandem
run: {env_steps: 40}
variants:
  - label: small
    set: {method.learner.batch: 64}
  - label: other
    method: mcbc
    set:
      method.horizon: 2
"""


def write(config: Path, text: str) -> None:
    (config / "ablations").mkdir(exist_ok=True)
    (config / "ablations" / "batch.yaml").write_text(text)


def refusal(config: Path, text: str) -> str:
    write(config, text)
    with pytest.raises(ScenarioError) as error:
        ablation.load("batch", config)
    return str(error.value)


def test_variants_and_seeds_become_runs_with_their_own_folders(config: Path, tmp_path: Path) -> None:
    write(config, FILE)
    runs = ablation.load("batch", config).runs(tmp_path, [0, 7])
    assert [(run.label, run.method, run.seed) for run in runs] == [
        ("small", "tandem", 0),
        ("other", "mcbc", 0),
        ("small", "tandem", 7),
        ("other", "mcbc", 7),
    ]
    assert runs[3].folder == RunFolder(tmp_path / "other-seed7")
    assert runs[3].typed_command() == (
        f"./tandem train peg --method mcbc --seed 7 --run {tmp_path}/other-seed7"
        " --set run.env_steps=40 --set method.horizon=2"
    )
    composed = runs[0].scenario(config)
    assert composed.data["method"]["learner"]["batch"] == 64
    assert composed.run["env_steps"] == 40
    assert str(composed.origins["method.learner.batch"]) == "config/ablations/batch.yaml:8"


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "task: peg",
            "tusk: peg",
            "config/ablations/batch.yaml:3: there is no key tusk; the nearest is task.",
        ),
        (
            "    method: mcbc",
            "    methode: mcbc",
            "config/ablations/batch.yaml:10: there is no key variants.1.methode; the nearest is method.",
        ),
        ("title: Batches\n", "", "config/ablations/batch.yaml:1: title is missing."),
        (
            "question: How large?",
            "question: 3",
            "config/ablations/batch.yaml:2: question is 3; it must be a text.",
        ),
        ("label: other", "label: small", "config/ablations/batch.yaml:9: there are two variants small"),
        (
            "label: other",
            "label: a/b",
            "config/ablations/batch.yaml:9: the label is 'a/b'; it must be of letters",
        ),
        (
            "- label: other\n    method",
            "- method",
            "config/ablations/batch.yaml:9: variants.1 must hold a label",
        ),
        (
            "set: {method.learner.batch: 64}",
            "set: 64",
            "config/ablations/batch.yaml:8: variants.0.set must hold keys and values",
        ),
    ],
)
def test_a_wrong_file_is_refused_with_file_and_line(config: Path, old: str, new: str, sentence: str) -> None:
    assert old in FILE
    assert refusal(config, FILE.replace(old, new)).startswith(sentence)


def test_one_variant_compares_nothing(config: Path) -> None:
    text = FILE[: FILE.index("  - label: other")]
    assert refusal(config, text).startswith(
        "config/ablations/batch.yaml:6: variants must be a list of two or more"
    )


def test_an_unknown_name_is_refused_with_the_nearest(config: Path) -> None:
    write(config, FILE)
    with pytest.raises(ScenarioError, match=r"no ablation 'bach'; there are: batch. Did you mean batch\?"):
        ablation.load("bach", config)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "method.horizon: 2",
            "method.horizn: 2",
            "other, seed 0: config/ablations/batch.yaml:12: there is no key method.horizn",
        ),
        (
            "env_steps: 40",
            "env_steps: 0",
            "small, seed 0: config/ablations/batch.yaml:5: run.env_steps is 0; it must be a whole number in [1,",
        ),
        ("method: mcbc", "method: mcbd", "other, seed 0: There is no method 'mcbd'"),
    ],
)
def test_a_wrong_setting_is_refused_before_any_run_with_the_line_that_says_it(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, sentence: str
) -> None:
    monkeypatch.setattr(
        "tandem.experiments.runs._ask_learner", lambda _: None
    )  # the small config is not a real one
    write(config, FILE.replace(old, new))
    with pytest.raises(ScenarioError) as error:
        check(ablation.load("batch", config).runs(tmp_path, [0]), config)
    assert str(error.value).startswith(sentence)


def test_parts_that_do_not_fit_are_refused_before_any_run(tmp_path: Path) -> None:
    runs = ablation.load("horizon").runs(tmp_path, [0], typed(["method.learner.critic.kind=td"]))
    with pytest.raises(
        ScenarioError, match=r"h_8, seed 0: .*td.steps is 4; it must not be less than the horizon of 8"
    ):
        check(runs)


def test_an_option_may_not_undo_what_the_variants_differ_in(tmp_path: Path) -> None:
    with pytest.raises(
        ScenarioError, match=r"^--set method.horizon=2: .* \(config/ablations/horizon.yaml:\d+\)"
    ):
        ablation.load("horizon").runs(tmp_path, [0], typed(["method.horizon=2"]))


def test_a_finished_run_of_another_scenario_is_not_shown_as_this_one(tmp_path: Path) -> None:
    runs = ablation.load("horizon").runs(tmp_path, [0])
    runs[0].scenario().write(runs[0].folder.scenario)
    runs[0].folder.summary.write_text("{}")
    check(runs)
    with pytest.raises(
        ScenarioError, match=r"h_1-seed0 holds a finished run of another scenario: run.env_steps"
    ):
        check(ablation.load("horizon").runs(tmp_path, [0], typed(["run.env_steps=40"])))


@pytest.mark.parametrize("name", ablation.names(CONFIG))
def test_every_shipped_ablation_composes_and_can_be_learnt(name: str, tmp_path: Path) -> None:
    loaded = ablation.load(name)
    runs = loaded.runs(tmp_path, [0])
    check(runs)
    scenarios = [run.scenario() for run in runs]
    for i, one in enumerate(scenarios):
        for other in scenarios[:i]:
            assert one.first_difference(other.copy_with(method=one.run["method"])) is not None


def test_some_variants_can_be_run_without_the_others(tmp_path: Path) -> None:
    chosen = ablation.load("critic")
    assert [run.label for run in chosen.only(["td_8", "mc"]).runs(tmp_path, [0])] == ["mc", "td_8"]
    with pytest.raises(ScenarioError, match="critic has no variant 'td_9'; the nearest is td_8"):
        chosen.only(["td_9"])


def test_ablations_are_listed_with_their_question() -> None:
    result = CliRunner().invoke(app, ["ablate", "--list"])
    assert result.exit_code == 0, result.output
    assert len(ablation.names()) >= 15
    for name in ablation.names():
        assert f"\n{name} " in "\n" + result.output


def test_ablate_without_a_name_or_without_runs_says_what_to_do(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["ablate"])
    assert result.exit_code == 2 and "name one of the ablations: critic, cut," in result.output
    result = CliRunner().invoke(app, ["ablate", "critic", "--collect-only", "--runs", str(tmp_path)])
    assert result.exit_code == 2 and "leave out --collect-only to train them" in result.output
