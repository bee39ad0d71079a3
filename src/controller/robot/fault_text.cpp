#include "controller/robot/robot.h"

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
  }
  return "an unknown fault";
}

}  // namespace tandem
