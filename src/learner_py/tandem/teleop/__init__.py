"""A person at the controls: keyboard or gamepad in, TELEOP_COMMAND out, the state of the arm on the screen.

    terminal ─ keys ─┐                                ┌─ pilot ──▶ TELEOP_COMMAND, 50 Hz
    gamepad ─────────┴▶ device ──▶ session (the loop) ┤
    CONTROLLER_STATUS, ROBOT_STATE, WORLD_STATE ─ watch ─▶ screen

The controller treats what comes from here as it treats the scripted operator's messages. Whatever happens to this
program, silence is safe: the controller's watchdog holds the arm, then gives it back to the policy.
"""
