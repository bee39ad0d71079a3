"""Faults of `Fault` in src/controller/robot/fault.h in words, for a status that comes without its sentence."""

ESTOP = 23

_TEXTS = {
    0: "no fault",
    1: "20 control cycles in a row passed without a command",
    2: "the commanded torque changed too fast",
    3: "the commanded torque was too large",
    4: "a joint left its range",
    5: "a joint was too fast",
    6: "a collision",
    7: "a torque was not finite",
    8: "the tool was too fast",
    9: "the robot was stopped by its own button",
    10: "the arm did not come to rest within 1 s",
    20: "the policy was silent",
    21: "the operator was silent",
    22: "the controller's link was silent",
    ESTOP: "an e-stop command",
}


def fault_text(fault: int) -> str:
    """A clause, `fault 99` when we don't know it."""
    return _TEXTS.get(fault, f"fault {fault}")
