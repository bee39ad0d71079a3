"""Episodes and scenarios made by hand, for the learner's tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import lcm
import numpy as np
import optax
from jax import lax
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.episode_step_t import episode_step_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.learner.config import LearnerScenario
from tandem.learner.episode import Episode, steps_digest
from tandem.learner.method import Batch
from tandem.scenario import compose, names

CONFIG = Path(__file__).parents[2] / "config"
METHODS = names(CONFIG / "methods")
N_OBSERVATION = 3


def messages(
    number: int,
    observation: Sequence[Sequence[float]]
    | None = None,  # (T + 1, O), the last one is seen after the last step
    executed: Sequence[Sequence[float]] | None = None,  # (T, 7)
    intervention: Sequence[int] = (),
    force_peak: Sequence[float] = (),  # (T,) N
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
        step.force_peak = force_peak[t] if force_peak else 0.0
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


SMALL_HEAD = {"hidden": [16]}
SMALL = {
    "head": {
        "mlp": SMALL_HEAD,
        "gaussian": SMALL_HEAD,
        "flow": SMALL_HEAD | {"steps": 4},
        "act": {"model_size": 8, "heads": 2, "feedforward": 16, "latent_size": 4},
    },
    "critic": {"hidden": [16], "members": 2},
    "improvement": {"edit": SMALL_HEAD},
    "replay": {"batch": 16},
    "image": {"channels": [4, 4], "features": 5, "shift_px": 2, "batch": 16, "updates_per_env_step": 2},
    "warm_start_updates": 70,
    "updates_per_env_step": 2,
    "checkpoint_every_s": 0,
}


def scenario_data(
    method: str = "mcbc",
    demonstrations: int = 2,
    env_steps: int = 40,
    horizon: int | None = None,
    observe: str = "state",
    **learner: Any,
) -> dict[str, Any]:
    """A resolved scenario as a dictionary: small networks unless a test asks otherwise. learner: merged into it."""
    section = compose(CONFIG, "peg", method, {}).data["method"]
    section["discount"] = 0.9
    if horizon is not None:
        section["horizon"] = horizon
        section["learner"]["critic"]["td"]["steps"] = horizon
    merge(section["learner"], SMALL)
    merge(section["learner"], learner)
    return {
        "run": {
            "mode": "train", "task": "peg", "method": method, "seed": 3, "demonstrations": demonstrations,
            "env_steps": env_steps, "learner_lag": 1, "evaluation_every": 20, "observe": observe,
        },
        "task": {
            "name": "peg", "policy_rate_hz": 10, "max_steps": 30,
            "translation_limit_m": 0.01, "rotation_limit_rad": 0.1, "observation": ["a", "b", "gripper_commanded"],
            "action_axes": ["x", "rz", "gripper"],
        },
        "controller": {"camera": {"name": "wrist", "views": ["wrist"], "width_px": 16, "height_px": 24}},
        "operator": {"delay": 1},
        "method": section,
    }  # fmt: skip


def merge(section: dict[str, Any], changes: dict[str, Any]) -> None:
    """Lays nested changes over a section."""
    for key, value in changes.items():
        if isinstance(value, dict):
            merge(section[key], value)
        else:
            section[key] = value


def scenario(**facts: Any) -> LearnerScenario:
    return LearnerScenario.model_validate(scenario_data(**facts))


def batch(n: int, **facts: Any) -> Batch:
    """n rows of a method with h = 1 and the three axes: all valid, nobody's, worth nothing; ended."""
    shape = np.shape(facts["chunk"])[:2] if "chunk" in facts else (n, 1)
    rows: dict[str, Any] = {
        "x": np.ones((n, N_OBSERVATION)), "chunk": np.zeros((n, 1, 3)), "valid": np.ones(shape, bool),
        "human": np.zeros(shape, bool), "mc_return": np.zeros(n), "next_x": np.ones((n, N_OBSERVATION)),
        "n_step_return": np.zeros(n), "bootstrap": np.zeros(n),
    }  # fmt: skip
    rows |= facts
    floats = {name: np.asarray(a) for name, a in rows.items()}
    return Batch(**{n: jnp.asarray(a, a.dtype if a.dtype == bool else np.float32) for n, a in floats.items()})


def minimise(loss: Callable[..., Any], params: Any, steps: int = 1000, rate: float = 5e-3) -> Any:
    """Adam on loss(params, key)."""
    optimizer = optax.adam(rate)

    def step(carry: Any, key: Any) -> Any:
        params, state = carry
        change, state = optimizer.update(jax.grad(loss)(params, key), state)
        return (optax.apply_updates(params, change), state), None

    run = quickly(lambda start, keys: lax.scan(step, start, keys)[0][0])
    return run((params, optimizer.init(params)), jax.random.split(jax.random.PRNGKey(0), steps))


def quickly(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiled without optimisation: tests compile longer than they compute."""
    return jax.jit(function, compiler_options={"xla_backend_optimization_level": 0})


def linear_critics(*weights: Sequence[float]) -> list[dict[str, Any]]:
    """Members whose value is w . (x, chunk)."""
    return [{"weight": jnp.array(weights, jnp.float32)[:, None, :], "bias": jnp.zeros((len(weights), 1))}]


def tree_bytes(tree: Any) -> bytes:
    """All leaves of a JAX tree, for bit-by-bit comparison."""
    return b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tree))
