"""How often a channel should come, Hz on the source's clock."""

from typing import Any

from tandem.scenario import Scenario

STATUS_HZ = 10.0  # CONTROLLER_STATUS, of wall time, in lockstep too
LEARNER_HZ = 1.0  # at least
ROBOT_STATE_HZ = 100.0  # where no scenario says otherwise
POLICY_HZ = 10.0
TICK_HZ = 1000.0
WIRE_LIMIT_HZ = (
    100.0  # the controller's link sends the latest ROBOT_STATE no more often; the log has them all
)


def rates(scenario: Scenario | None, robot_time: bool, live: bool = False) -> dict[str, float]:
    """Channel -> rate.

    robot_time: the source's clock is the robot's (a real-time run, or any log). In lockstep the robot's time passes as
    fast as the machine allows, so live only what is bound to wall time has a rate to expect.
    """
    expected = {"CONTROLLER_STATUS": STATUS_HZ, "LEARNER_STATUS": LEARNER_HZ}
    if not robot_time:
        return expected
    run: dict[str, Any] = scenario.run if scenario else {}
    task: dict[str, Any] = scenario.data["task"] if scenario else {}
    policy_hz = float(task.get("policy_rate_hz", POLICY_HZ))
    robot_state_hz = float(run.get("robot_state_hz", ROBOT_STATE_HZ))
    expected |= {"CONTROL_TICK": TICK_HZ, "WORLD_STATE": policy_hz, "TELEOP_COMMAND": policy_hz}
    if robot_state_hz > 0:
        expected["ROBOT_STATE"] = min(robot_state_hz, WIRE_LIMIT_HZ) if live else robot_state_hz
    return expected
