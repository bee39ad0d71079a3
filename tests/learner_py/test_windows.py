"""What a window may know: tails, returns, truncation, interventions, masks, and episodes that must not enter."""

from __future__ import annotations

import numpy as np
import pytest
import support
from tandem_lcm.tandem.episode_end_t import episode_end_t

from tandem.learner.windows import make_windows, rest_of_the_way

ALL_AXES = range(7)


def windows(episode, columns=ALL_AXES, horizon=3, discount=0.9, cut=False, **bootstrap):
    return make_windows(episode, columns, horizon, discount, cut, **bootstrap)


def test_chunk_is_the_executed_actions_from_t_on():
    actions = np.arange(5 * 7).reshape(5, 7) / 100
    result = windows(support.episode(0, executed=actions))
    np.testing.assert_allclose(result.chunk[1], actions[1:4], atol=1e-7)
    assert result.chunk.shape == (5, 3, 7) and result.valid[:3].all()


def test_tail_is_kept_and_padded_by_hold_with_the_same_gripper():
    actions = np.full((4, 7), 0.25)
    actions[-1, 6] = 1.0
    result = windows(support.episode(0, executed=actions))
    assert len(result.chunk) == 4
    np.testing.assert_array_equal(result.chunk[3, 1:], [[0, 0, 0, 0, 0, 0, 1]] * 2)
    np.testing.assert_array_equal(result.valid, [[1, 1, 1], [1, 1, 1], [1, 1, 0], [1, 0, 0]])


def test_tail_may_repeat_the_last_action_so_that_it_does_not_tell_the_end():
    actions = np.arange(4 * 7).reshape(4, 7) / 100
    result = windows(support.episode(0, executed=actions), repeat_at_the_end=True)
    np.testing.assert_allclose(result.chunk[2], actions[[2, 3, 3]], atol=1e-7)
    np.testing.assert_array_equal(result.valid[2], [1, 1, 0])


def test_masked_axes_are_dropped_in_wire_order():
    actions = np.tile(np.arange(7) / 10, (4, 1))
    result = windows(support.episode(0, executed=actions), columns=[0, 5, 6])
    np.testing.assert_allclose(result.chunk[0, 0], [0.0, 0.5, 0.6], atol=1e-7)
    np.testing.assert_allclose(result.chunk[3, 2], [0.0, 0.0, 0.6], atol=1e-7)


def test_return_counts_discounted_steps_to_success():
    np.testing.assert_allclose(
        windows(support.episode(0, n_steps=4)).mc_return, [0.729, 0.81, 0.9, 1.0], rtol=1e-6
    )


def test_time_out_and_failure_earn_nothing():
    for outcome in (episode_end_t.TIMEOUT, episode_end_t.FAILURE):
        assert not windows(support.episode(0, n_steps=4, outcome=outcome)).mc_return.any()


def test_a_hard_contact_costs_what_came_before_it_cut_or_not():
    episode = support.episode(0, n_steps=4, force_peak=[10, 70, 10, 0], intervention=[0, 0, 0, 1])
    force = {"force_free_N": 50.0, "force_cost_per_N": 0.01}  # 20 N above: 0.2
    np.testing.assert_allclose(
        windows(episode, **force).mc_return, [0.729 - 0.18, 0.81 - 0.2, 0.9, 1.0], atol=1e-6
    )
    np.testing.assert_allclose(windows(episode, cut=True, **force).mc_return, [-0.18, -0.2, 0, 1], atol=1e-6)
    np.testing.assert_allclose(windows(episode, **force).n_step_return, [0, -0.2, 0, 1], atol=1e-6)


def test_a_hard_contact_is_blamed_on_what_came_just_before_by_a_discount_of_its_own():
    episode = support.episode(0, n_steps=4, force_peak=[10, 10, 70, 0])
    force = {"force_free_N": 50.0, "force_cost_per_N": 0.01, "force_discount": 0.5}  # 20 N above: 0.2
    result = windows(episode, **force)
    np.testing.assert_allclose(result.mc_return, [0.729 - 0.05, 0.81 - 0.1, 0.9 - 0.2, 1.0], atol=1e-6)
    # what a bootstrap sums up is the method's own
    np.testing.assert_allclose(result.n_step_return, [0, 0, -0.2, 1], atol=1e-6)


# what the value of the next observation counts, t = 0 .. 5 of an episode of six steps, discount 0.9
ONE_STEP, FOUR_STEPS = [0.9] * 6, [0.9**4] * 3 + [0.9**3, 0.9**2, 0.9]


@pytest.mark.parametrize(
    ("steps", "outcome", "timeout_is_terminal", "earned", "counts"),
    [
        (1, episode_end_t.SUCCESS, False, [0, 0, 0, 0, 0, 1], [*ONE_STEP[:5], 0]),
        (1, episode_end_t.FAILURE, False, [0] * 6, [*ONE_STEP[:5], 0]),
        (1, episode_end_t.TIMEOUT, False, [0] * 6, ONE_STEP),
        (1, episode_end_t.TIMEOUT, True, [0] * 6, [*ONE_STEP[:5], 0]),
        (4, episode_end_t.SUCCESS, False, [0, 0, 0.9**3, 0.9**2, 0.9, 1], [*FOUR_STEPS[:2], 0, 0, 0, 0]),
        (4, episode_end_t.FAILURE, True, [0] * 6, [*FOUR_STEPS[:2], 0, 0, 0, 0]),
        (4, episode_end_t.TIMEOUT, False, [0] * 6, FOUR_STEPS),
        (4, episode_end_t.TIMEOUT, True, [0] * 6, [*FOUR_STEPS[:2], 0, 0, 0, 0]),
    ],
)
def test_bootstrap_sums_n_rewards_and_goes_on_where_the_episode_did_not_truly_end(
    steps, outcome, timeout_is_terminal, earned, counts
):
    episode = support.episode(0, n_steps=6, outcome=outcome)
    result = windows(episode, bootstrap_steps=steps, timeout_is_terminal=timeout_is_terminal)
    np.testing.assert_allclose(result.n_step_return, earned, atol=1e-6)
    np.testing.assert_allclose(result.bootstrap, counts, rtol=1e-6)


def test_bootstrap_leaves_the_return_that_was_earned_alone():
    """R + b G of the step that the window leads to is G again."""
    episode = support.episode(0, n_steps=9)
    for steps in (1, 2, 4, 20):
        result = windows(episode, bootstrap_steps=steps)
        later = np.append(result.mc_return, np.zeros(20))[steps : steps + 9]
        np.testing.assert_allclose(
            result.n_step_return + result.bootstrap * later, result.mc_return, rtol=1e-5
        )


@pytest.mark.parametrize(("steps", "places"), [(1, [1, 2, 3, 4, 5]), (4, [4, 5, 5, 5, 5])])
def test_next_observation_follows_the_n_steps_and_never_leaves_the_episode(steps, places):
    result = windows(support.episode(7, n_steps=5), bootstrap_steps=steps)
    np.testing.assert_array_equal(result.next_observation[:, 1], places)
    np.testing.assert_array_equal(result.next_observation[:, 0], [7] * 5)


def test_return_that_differs_from_the_wire_is_refused_with_a_sentence():
    with pytest.raises(ValueError, match=r"Episode 4, step 0: discounted_return is .* discount 0\.99"):
        windows(support.episode(4, n_steps=5, discount=0.9), discount=0.99)


def test_cut_zeroes_autonomous_steps_before_the_last_takeover_only():
    episode = support.episode(0, n_steps=7, intervention=[0, 1, 0, 0, 1, 0, 0])
    whole, cut = windows(episode, horizon=1), windows(episode, horizon=1, cut=True)
    np.testing.assert_array_equal(cut.mc_return[[0, 2, 3]], 0)
    np.testing.assert_array_equal(cut.mc_return[[1, 4, 5, 6]], whole.mc_return[[1, 4, 5, 6]])
    np.testing.assert_array_equal(cut.human[:, 0], [0, 1, 0, 0, 1, 0, 0])


def test_cut_leaves_episodes_without_a_human_and_demonstrations_alone():
    alone = support.episode(0, n_steps=4)
    np.testing.assert_array_equal(windows(alone, cut=True).mc_return, windows(alone).mc_return)
    # a person may pause in a demonstration: it is his all the same
    shown = support.demonstration(0, n_steps=4, intervention=[0, 1, 0, 1])
    assert (windows(shown, cut=True).mc_return > 0).all() and windows(shown).human[:, 0].all()


def test_human_mask_follows_the_steps_of_the_window_and_excludes_padding():
    result = windows(support.episode(0, n_steps=4, intervention=[0, 1, 1, 1]))
    np.testing.assert_array_equal(result.human, [[0, 1, 1], [1, 1, 1], [1, 1, 0], [1, 0, 0]])


@pytest.mark.parametrize("outcome", [episode_end_t.FAULT, episode_end_t.DISCARD])
def test_faulted_and_discarded_episodes_never_enter(outcome):
    with pytest.raises(ValueError, match="must not reach the learner"):
        windows(support.episode(0, outcome=outcome))
    with pytest.raises(ValueError):
        windows(support.demonstration(0, outcome=outcome))


def test_failed_demonstrations_never_enter():
    assert not support.demonstration(0, outcome=episode_end_t.TIMEOUT).is_learnable


def test_learning_uses_what_was_executed_not_what_was_asked():
    result = windows(support.episode(0, n_steps=3))
    assert result.chunk.min() >= 0.0  # human asked -0.5, policy 0.5
    assert result.chunk.max() < 0.1


def test_rest_of_the_way_ends_where_the_hand_is_told_otherwise_and_is_unknown_without_success():
    actions, lead = np.zeros((5, 7), np.float32), np.zeros((6, 6), np.float32)
    actions[:, 0] = [0.5, 1.0, -0.25, 1.0, 1.0]
    actions[:, 6] = [-1.0, -1.0, 1.0, 1.0, 1.0]
    lead[2, 0], lead[5, 0] = 0.001, 0.004  # it pushes when the hand closes, and harder at the end
    limit = np.full(6, 0.01, np.float32)
    done = support.episode(0, executed=actions)
    expected = [0.014, 0.009, 0.0145, 0.016, 0.006]
    np.testing.assert_allclose(rest_of_the_way(done, lead, limit)[:, 0], expected, atol=1e-7)
    failed = support.episode(0, n_steps=5, outcome=episode_end_t.TIMEOUT)
    assert np.isnan(rest_of_the_way(failed, lead, limit)).all()
