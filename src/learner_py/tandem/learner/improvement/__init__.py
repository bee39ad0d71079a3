"""How the actor improves, one module an idea. Each has

    loss(method, trained, fixed, batch, q_buffer, key) -> (loss, policy_wins (B,))

trained: the networks that the gradient goes to (actor, and where used edit and temperature). fixed: the others as they
are (critic, value). q_buffer (B,): the critic's score of the batch's chunks. policy_wins: all false where nothing is
compared.
"""

from __future__ import annotations

from tandem.learner.improvement import awr, e2hil, expo, imitate, max_q, q_gradient, sac

LOSSES = {
    "imitate": imitate.loss,
    "max_q": max_q.loss,
    "awr": awr.loss,
    "q_gradient": q_gradient.loss,
    "sac": sac.loss,
    "e2hil": e2hil.loss,
    "expo": expo.loss,
}

__all__ = ["LOSSES"]
