"""Event logs and whole episodes: nothing that is not complete, everything that is."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import support

from tandem.learner.episode import EpisodeAssembler, steps_digest
from tandem.log import episodes, messages


def test_episodes_of_a_log_come_back_with_their_numbers(tmp_path):
    sent = [support.messages(number, n_steps=3 + number) for number in range(3)]
    support.write_log(tmp_path / "log.lcm", sent)
    back = list(episodes(tmp_path / "log.lcm"))
    assert [(episode.number, episode.n_steps) for episode in back] == [(0, 3), (1, 4), (2, 5)]
    np.testing.assert_allclose(back[2].observation[:, 1], range(5))
    assert len(list(messages(tmp_path / "log.lcm", "EPISODE_END"))) == 3


def test_cut_off_tail_costs_the_last_episode_only(tmp_path):
    support.write_log(tmp_path / "log.lcm", [support.messages(number) for number in range(3)])
    whole = (tmp_path / "log.lcm").read_bytes()
    for missing in range(1, 400, 7):
        (tmp_path / "cut.lcm").write_bytes(whole[:-missing])
        assert [episode.number for episode in episodes(tmp_path / "cut.lcm")] == [0, 1]


def test_empty_and_absent_logs_are_told_apart(tmp_path):
    (tmp_path / "log.lcm").write_bytes(b"")
    assert list(episodes(tmp_path / "log.lcm")) == []
    with pytest.raises(FileNotFoundError, match="There is no event log at"):
        list(episodes(tmp_path / "none.lcm"))


def test_episode_that_was_run_again_after_a_crash_counts_once(tmp_path):
    steps, end = support.messages(0)
    stale = copy.deepcopy(steps[:3])
    stale[0].observation = [9.0, 9.0, 9.0]
    never_ended = copy.deepcopy(end)
    never_ended.steps_sha256 = "0" * 64
    support.write_log(tmp_path / "log.lcm", [(stale, never_ended), (steps, end), (steps, end)])
    back = list(episodes(tmp_path / "log.lcm"))
    assert len(back) == 1 and back[0].observation[0, 0] == 0.0


def test_assembler_takes_parts_in_any_order_and_names_what_is_missing():
    steps, end = support.messages(5, n_steps=4)
    assembler = EpisodeAssembler()
    assembler.add_end(end)
    for index in (3, 1, 1):
        assembler.add_step(steps[index], steps[index].encode())
    assert assembler.take(5) is None and assembler.missing_steps(5) == [0, 2]
    for index in (2, 0):
        assembler.add_step(steps[index], steps[index].encode())
    episode = assembler.take(5)
    assert episode is not None and episode.n_steps == 4
    assert assembler.ended() == []


def test_wrong_digest_makes_all_steps_missing_again():
    steps, end = support.messages(5, n_steps=4)
    end.steps_sha256 = steps_digest([b"something else"])
    assembler = EpisodeAssembler()
    assembler.add_end(end)
    for step in steps:
        assembler.add_step(step, step.encode())
    assert assembler.take(5) is None and assembler.missing_steps(5) == [0, 1, 2, 3]


def test_digest_is_over_the_bytes_as_received():
    steps, end = support.messages(1)
    assert steps_digest(step.encode() for step in steps) == end.steps_sha256
