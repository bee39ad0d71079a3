#include "controller/robot/fault.h"

namespace tandem {

const char* fault_text(Fault fault) {
  switch (fault) {
    case Fault::none:
      return "no fault";
    case Fault::communication_constraints_violation:
      return "20 consecutive control cycles passed without a command";
    case Fault::torque_discontinuity:
      return "the commanded torque changed faster than 1000 N m/s";
    case Fault::torque_range:
      return "the commanded torque is beyond 87 N m (joints 1 to 4) or 12 N m (joints 5 to 7)";
    case Fault::joint_position_limit:
      return "a joint is beyond its position limit";
    case Fault::joint_velocity_limit:
      return "a joint is faster than its velocity limit";
    case Fault::collision:
      return "the external torque or force is above the collision threshold";
    case Fault::not_finite:
      return "the commanded torque is not a finite number";
    case Fault::cartesian_velocity_limit:
      return "the tool is faster than 1.7 m/s or 2.5 rad/s";
    case Fault::user_stop:
      return "the robot was stopped by its own button";
    case Fault::finish_timeout:
      return "the arm was still moving 1 s after the end of the motion was asked for";
    case Fault::policy_silent:
      return "the policy gave no action for too long";
    case Fault::operator_silent:
      return "the operator was silent for too long while he had the arm";
    case Fault::link_silent:
      return "the link thread was silent for too long, so that no one could have stopped the arm";
    case Fault::estop:
      return "an e-stop command came";
  }
  return "an unknown fault";
}

}  // namespace tandem
