"""What a run's critic is asked afterwards, on a log made by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import support
import yaml
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.learner.config import load_scenario
from tandem.learner.diagnosis import Question, diagnose, quicker_gain
from tandem.learner.windows import make_windows
from tandem.run_folder import RunFolder


def run_folder(path, n_training):
    """Two demonstrations, then episodes that succeed when every action is positive; the human helps in every third."""
    generator = np.random.default_rng(0)
    messages = []
    for number in range(2 + n_training):
        good = number < 2 or number % 2 == 0
        actions = (0.8 if good else -0.8) + 0.1 * generator.standard_normal((5, 7))
        facts = {"phase": world_state_t.DEMONSTRATION} if number < 2 else {}
        helped = [0, 0, 0, 1, 1] if number >= 2 and number % 3 == 0 else []
        messages.append(
            support.messages(
                number,
                observation=generator.standard_normal((6, 3)),
                executed=actions.clip(-1, 1),
                intervention=helped,
                outcome=episode_end_t.SUCCESS if good else episode_end_t.TIMEOUT,
                env_steps_total=5 * max(0, number - 1),
                **facts,
            )
        )
    path.mkdir()
    support.write_log(path / "log.lcm", messages)
    # without the cut the return is what the actions decide
    data = support.scenario_data(critic={"cut_return_at_intervention": False})
    (path / "scenario.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    return RunFolder(path)


def test_a_critic_that_can_tell_is_told_from_one_that_cannot(tmp_path):
    folder = run_folder(tmp_path / "run", n_training=60)
    scenario = load_scenario(folder.scenario)
    fresh, learnt = (diagnose(folder, scenario, updates) for updates in (1, 600))
    assert learnt["held_out_episodes"] == 12 and learnt["held_out_steps"] == 60
    assert fresh["r_squared"] < 0.2 < 0.6 < learnt["r_squared"]
    # a disturbed action is worse where all were good, and no better where all were bad
    assert learnt["disturbed_wins"]["1.0"] < 0.6
    assert (
        learnt["human_pairs"] == 0 and learnt["human_wins"] is None
    )  # no checkpoint: nobody to compare him with


def test_the_operator_is_described_from_the_whole_log(tmp_path):
    folder = run_folder(tmp_path / "run", n_training=60)
    operator = diagnose(folder, load_scenario(folder.scenario), 1)["operator"]
    assert operator["episodes"] == 60
    assert operator["helped"] == pytest.approx(20 / 60)
    assert operator["human_steps"] == pytest.approx(20 * 2 / 300)
    assert operator["success_alone"] == pytest.approx(0.5)


def test_too_short_a_run_is_refused_with_a_sentence(tmp_path):
    folder = run_folder(tmp_path / "run", n_training=7)
    with pytest.raises(ValueError, match=r"has 7 training episodes; 10 are needed"):
        diagnose(folder, load_scenario(folder.scenario), 1)


def test_quicker_is_asked_of_the_policys_own_motion_where_the_arm_is_on_its_way():
    """A critic whose score is the sum of a chunk's actions, so that a quarter more is worth a quarter of the motion."""
    axes = ["x", "z", "gripper"]
    executed = np.zeros((4, 7))
    executed[:, 0], executed[:, 2], executed[:, 6] = [0.6, 0.1, 0.6, 0.9], [0.0, 0.1, 0.0, 0.4], 1.0
    episode = support.episode(0, executed=executed, intervention=[0, 0, 1, 0])
    windows = make_windows(episode, [0, 2, 6], 1, 0.9)
    trainer = SimpleNamespace(
        scenario=SimpleNamespace(task=SimpleNamespace(action_axes=axes)),
        score=lambda _observation, chunk, _image: chunk.sum(axis=(1, 2)),
    )
    # of the four steps one is slow and one the human's; 0.9 can only become 1
    gain = quicker_gain(trainer, [Question(episode, windows, None)])
    assert gain == pytest.approx((0.15 + 0.1 + 0.1) / 2, abs=1e-6)
    slow = make_windows(support.episode(1, n_steps=2), [0, 2, 6], 1, 0.9)
    assert quicker_gain(trainer, [Question(episode, slow, None)]) is None
