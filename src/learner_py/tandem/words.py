"""What the numbers in messages stand for, in words."""

from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.world_state_t import world_state_t

PHASES = {
    world_state_t.DEMONSTRATION: "demonstrations",
    world_state_t.TRAINING: "training",
    world_state_t.EVALUATION: "evaluation",
}
STATES = {
    controller_status_t.WAITING: "waiting",
    controller_status_t.RUNNING: "running",
    controller_status_t.RESETTING: "resetting",
    controller_status_t.FINISHED: "finished",
    controller_status_t.FAULTED: "faulted",
    controller_status_t.HALTED: "halted",
}
OUTCOMES = {
    episode_end_t.SUCCESS: "success",
    episode_end_t.TIMEOUT: "timeout",
    episode_end_t.FAULT: "fault",
    episode_end_t.DISCARD: "discard",
    episode_end_t.FAILURE: "failure",
}
ROBOT_MODES = {0: "idle", 1: "moving", 2: "reflex", 3: "stopped by the user"}
