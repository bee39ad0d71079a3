"""The scenario of a soak: the peg task in real time, a learner that costs little, a robot on which things go wrong."""

from __future__ import annotations

from tandem.run_folder import CONFIG
from tandem.scenario import Scenario, compose

# The run ends when the monkey's time is up, not when a budget is spent; no evaluations, no video.
_RUN = {
    "run.demonstrations": 2,
    "run.env_steps": 10_000_000,
    "run.evaluation_every": 10_000_000,
    "run.video_episodes": 0,
    "controller.faults_in_a_row": 1000,
}

# A tenth of a second of one core per episode.
_LEARNER = {
    "method.learner.head.flow.hidden": "[32, 32]",
    "method.learner.critic.hidden": "[32, 32]",
    "method.learner.critic.members": 2,
    "method.learner.warm_start_updates": 200,
    "method.learner.updates_per_env_step": 0.5,
    "method.learner.replay.batch": 64,
    "method.learner.checkpoint_every_s": 3,
}

# Of 60 000 cycles a minute: about one fault of the robot's own, a dozen disturbances that it must bear.
_ROBOT = {
    "controller.robot.inject.lost_commands": 0.002,
    "controller.robot.inject.lost_bursts.probability": 3e-5,  # longest 25, so that a quarter reaches 20 misses
    "controller.robot.inject.corrupted_commands.probability": 4e-6,
    "controller.robot.inject.pushes.probability": 1e-4,
    "controller.robot.inject.user_stop": 8e-6,
}


def soak_scenario(seed: int) -> Scenario:
    """@raises ScenarioError"""
    overrides = [f"{key}={value}" for key, value in {**_RUN, **_LEARNER, **_ROBOT}.items()]
    return compose(CONFIG, "peg", "tandem", {"mode": "train", "seed": seed, "clock": "realtime"}, overrides)
