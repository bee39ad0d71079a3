#pragma once

#include <cstdint>

namespace tandem {

/// Every way in which a motion ends against our will; latched until recovery. On the wire as is.
enum class Fault : int32_t {
  none = 0,
  // The robot's own: it has stopped already.
  communication_constraints_violation = 1,  ///< 20 consecutive cycles without a command
  torque_discontinuity = 2,                 ///< commanded torque changed faster than 1000 N m/s
  torque_range = 3,                         ///< |tau| over 87 N m (joints 1-4) or 12 N m (5-7)
  joint_position_limit = 4,
  joint_velocity_limit = 5,
  collision = 6,   ///< external torque or force above the collision threshold
  not_finite = 7,  ///< a NaN or infinity was commanded, or came out of the law
  cartesian_velocity_limit = 8,
  user_stop = 9,        ///< someone pressed the robot's own stop button
  finish_timeout = 10,  ///< the arm was still moving 1 s after the end of the motion was asked for
  // The controller's: it stops the robot.
  policy_silent = 20,
  operator_silent = 21,
  link_silent = 22,
  estop = 23,
};

/// One English clause per fault, e.g. "20 consecutive control cycles passed without a command".
const char* fault_text(Fault fault);

}  // namespace tandem
