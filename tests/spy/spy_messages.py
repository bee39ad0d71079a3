"""Messages as a run sends them, and small real event logs, written by LCM's own writer."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import lcm
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.robot_state_t import robot_state_t
from tandem_lcm.tandem.world_state_t import world_state_t

STEP_US, SLOT_US = 100_000, 12_000_000
STEPS = 20  # of an episode


def robot(episode: int, tick: int, alpha: float = 0.0) -> robot_state_t:
    message = robot_state_t()
    message.episode, message.tick, message.alpha = episode, tick, alpha
    message.F_ext_W = [0.0, 0.0, tick / 1000, 0.0, 0.0, 0.0]
    message.force_bound_W = [20.0] * 6
    message.robot_mode = 1
    message.success_rate = 1.0
    return message


def world(episode: int, step: int) -> world_state_t:
    message = world_state_t()
    message.episode, message.step, message.tick, message.phase = episode, step, 100 * step, message.TRAINING
    message.max_steps = 120
    return message


def end(episode: int, outcome: int = episode_end_t.SUCCESS, human: int = 0) -> episode_end_t:
    message = episode_end_t()
    message.episode, message.outcome, message.phase = episode, outcome, world_state_t.TRAINING
    message.n_steps, message.n_intervention_steps, message.n_takeovers = STEPS, human, int(human > 0)
    message.env_steps_total, message.policy_version = STEPS * (episode + 1), episode + 1
    return message


def status(**values: Any) -> controller_status_t:
    message = controller_status_t()
    message.env_steps_budget = 100
    for name, value in values.items():
        setattr(message, name, value)
    return message


def write(path: Path, events: Iterable[tuple[int, str, Any]]) -> Path:
    """Events of (us, channel, message or bytes)."""
    log = lcm.EventLog(str(path), "w", overwrite=True)
    for at, channel, message in events:
        log.write_event(at, channel, message if isinstance(message, bytes) else message.encode())
    log.close()
    return path


def episodes(n: int) -> Iterable[tuple[int, str, Any]]:
    """As the recorder writes them in lockstep: two seconds of motion in each slot of twelve, then silence."""
    for episode in range(n):
        begin = episode * SLOT_US
        for step in range(STEPS):
            yield begin + step * STEP_US, "WORLD_STATE", world(episode, step)
            for i in range(10):
                tick = 100 * step + 10 * (i + 1)
                yield begin + 1000 * tick, "ROBOT_STATE", robot(episode, tick, alpha=float(episode % 2))
        yield begin + STEPS * STEP_US, "EPISODE_END", end(episode, human=5 * (episode % 2))
