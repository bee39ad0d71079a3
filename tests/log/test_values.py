"""Q on the episode page is what the policy file's critic says, and interventions are where the log has them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "learner_py"))
import support

from tandem.log.episode_page import interventions


def test_stretches_of_interventions_are_told_by_their_edges() -> None:
    episode = support.episode(0, n_steps=7, intervention=[1, 1, 0, 0, 1, 0, 1])
    assert interventions(episode) == [(0, 2), (4, 5), (6, 7)]
    assert interventions(support.episode(0, n_steps=3)) == []


def test_executed_chunks_end_in_hold() -> None:
    from tandem.learner.windows import executed_chunks

    episode = support.episode(0, n_steps=3)
    chunk, valid = executed_chunks(episode, [0, 6], 2)
    np.testing.assert_allclose(chunk[-1], [[0.02, 0.02], [0.0, 0.02]], atol=1e-6)
    assert valid.tolist() == [[True, True], [True, True], [True, False]]
