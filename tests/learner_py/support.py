"""Episodes and scenarios made by hand, for the learner's tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lcm
import numpy as np
import yaml
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.episode_step_t import episode_step_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.learner.config import LearnerScenario
from tandem.learner.episode import Episode, steps_digest

METHODS = Path(__file__).parents[2] / "config" / "methods"
N_OBSERVATION = 3


def messages(
    number: int,
    observation: Sequence[Sequence[float]]
    | None = None,  # (T + 1, O), the last one is seen after the last step
    executed: Sequence[Sequence[float]] | None = None,  # (T, 7)
    intervention: Sequence[int] = (),
    outcome: int = episode_end_t.SUCCESS,
    phase: int = world_state_t.TRAINING,
    n_steps: int = 5,
    discount: float = 0.9,
    env_steps_total: int = 0,
) -> tuple[list[episode_step_t], episode_end_t]:
    """What the controller would send. Default: observation t of episode e is (e, t, 0.1 t), action t all 0.01 t."""
    n_steps = len(executed) if executed is not None else n_steps
    steps = []
    for t in range(n_steps):
        step = episode_step_t()
        step.utime, step.episode, step.step = 1000 * t, number, t
        both = [[number, s, 0.1 * s] if observation is None else list(observation[s]) for s in (t, t + 1)]
        step.observation, step.next_observation = both
        step.n_observation = len(step.observation)
        step.executed_action = [0.01 * t] * 7 if executed is None else list(executed[t])
        step.policy_action = [0.5] * 7
        step.human_action = [-0.5] * 7
        step.intervention = intervention[t] if intervention else 0
        last = t == n_steps - 1
        step.terminated = int(last and outcome in (episode_end_t.SUCCESS, episode_end_t.FAILURE))
        step.truncated = int(last and outcome == episode_end_t.TIMEOUT)
        step.reward = float(last and outcome == episode_end_t.SUCCESS)
        step.discounted_return = discount ** (n_steps - 1 - t) if outcome == episode_end_t.SUCCESS else 0.0
        steps.append(step)
    end = episode_end_t()
    end.episode, end.phase, end.outcome, end.n_steps = number, phase, outcome, n_steps
    end.n_intervention_steps = sum(step.intervention for step in steps)
    end.env_steps_total = env_steps_total
    end.steps_sha256 = steps_digest(step.encode() for step in steps)
    return steps, end


def as_received(
    steps: list[episode_step_t], end: episode_end_t
) -> tuple[list[episode_step_t], episode_end_t]:
    """Through the encoding, so that floats are what the wire makes of them."""
    return [episode_step_t.decode(step.encode()) for step in steps], episode_end_t.decode(end.encode())


def episode(number: int, **facts: Any) -> Episode:
    return Episode.from_messages(*as_received(*messages(number, **facts)))


def demonstration(number: int, **facts: Any) -> Episode:
    return episode(number, phase=world_state_t.DEMONSTRATION, **facts)


def write_log(path: Path, all_messages: Sequence[tuple[list[episode_step_t], episode_end_t]]) -> None:
    """Appends to a new event log, in order."""
    log = lcm.EventLog(str(path), "w", overwrite=True)
    time = 0
    for steps, end in all_messages:
        for channel, message in [("EPISODE_STEP", step) for step in steps] + [("EPISODE_END", end)]:
            time += 1
            log.write_event(time, channel, message.encode())
    log.close()


def scenario_data(
    method: str = "tandem", demonstrations: int = 2, env_steps: int = 40, **learner: Any
) -> dict[str, Any]:
    """A resolved scenario as a dictionary: small networks unless a test asks otherwise."""
    section = yaml.safe_load((METHODS / f"{method}.yaml").read_text())
    section["discount"] = 0.9
    small = {"warm_start_updates": 70, "updates_per_env_step": 2, "batch": 16, "checkpoint_every_s": 0}
    section["learner"].update(small)
    section["learner"]["head"]["hidden"] = [16]
    section["learner"]["critic"].update({"hidden": [16], "members": 2})
    for key, value in learner.items():
        if isinstance(value, dict):
            section["learner"][key].update(value)
        else:
            section["learner"][key] = value
    return {
        "run": {
            "mode": "train", "task": "peg", "method": method, "seed": 3, "demonstrations": demonstrations,
            "env_steps": env_steps, "learner_lag": 1, "evaluation_every": 20,
        },
        "task": {
            "name": "peg", "policy_rate_hz": 10, "max_steps": 30, "observation": ["a", "b", "c"],
            "action_axes": ["x", "rz", "gripper"],
        },
        "controller": {"gain": 1},
        "operator": {"delay": 1},
        "method": section,
    }  # fmt: skip


def scenario(**facts: Any) -> LearnerScenario:
    return LearnerScenario.model_validate(scenario_data(**facts))


def tree_bytes(tree: Any) -> bytes:
    """All leaves of a JAX tree, for bit-by-bit comparison."""
    import jax

    return b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tree))
