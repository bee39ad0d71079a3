"""Unconstrained: up the critic's slope, -mean Q(x, policy(x)). The actor of DDPG, and of IBRL."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tandem.learner.networks import Array

if TYPE_CHECKING:
    from tandem.learner.method import Batch, Method, Networks


def loss(
    method: Method, trained: Networks, fixed: Networks, batch: Batch, q_buffer: Array, key: Array
) -> tuple[Array, Array]:
    own = method.actor.sample(trained["actor"], batch.x, key)
    q_policy = method.values(fixed["critic"], batch.x, own).mean(axis=0)
    return -q_policy.mean(), q_policy >= q_buffer
