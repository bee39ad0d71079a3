#pragma once

#include <cstdint>

#include "base/geometry.h"

/// The robot as Franka's control interface (FCI) shows it: one torque command per 1 ms cycle.
namespace tandem {

enum class RobotMode : int8_t { idle = 0, moving = 1, reflex = 2, user_stopped = 3 };

enum class Fault : int32_t {
  none = 0,
  communication_constraints_violation = 1,  ///< 20 consecutive cycles without a command
  torque_discontinuity = 2,                 ///< commanded torque changed faster than 1000 N m/s
  torque_range = 3,                         ///< |tau| over 87 N m (joints 1-4) or 12 N m (5-7)
  joint_position_limit = 4,
  joint_velocity_limit = 5,
  collision = 6,   ///< external torque or force above the collision threshold
  not_finite = 7,  ///< a NaN or infinity was commanded
};

/// One English clause per fault, e.g. "20 consecutive control cycles passed without a command".
const char* fault_text(Fault fault);

/// What the robot measured at the start of a control cycle. Gravity is compensated by the robot and
/// excluded from torques.
struct RobotState {
  JointVector q = JointVector::Zero();   ///< rad
  JointVector dq = JointVector::Zero();  ///< rad/s
  JointVector tau_measured =
      JointVector::Zero();  ///< N m, received by the joints in the last cycle
  JointVector tau_commanded =
      JointVector::Zero();  ///< N m, the last command that the robot received
  JointVector tau_external =
      JointVector::Zero();     ///< N m, + = environment pushes the joint forward; unfiltered
  double gripper_width = 0.0;  ///< m
  double success_rate = 0.0;   ///< share of the last 100 cycles with a command, 0 while idle
  RobotMode mode = RobotMode::idle;
  Fault fault = Fault::none;  ///< latched until recover()
  uint64_t cycle = 0;         ///< control cycles since construction
};

/// Mass that hangs on the flange beside the URDF's own bodies (an object in hand), as in Franka's
/// setLoad.
struct Load {
  double mass = 0.0;                                ///< kg
  Eigen::Vector3d com_E = Eigen::Vector3d::Zero();  ///< m, centre of mass in the tool frame E
  Eigen::Matrix3d inertia_E =
      Eigen::Matrix3d::Zero();  ///< kg m^2, about the centre of mass, axes of E
};

/// One cycle is: state(), then either write() or miss(). Nothing here allocates, locks or throws
/// after construction.
class Robot {
 public:
  virtual ~Robot() = default;

  /// State at the start of the present cycle.
  virtual const RobotState& state() const noexcept = 0;

  /// Command for the present cycle (N m, gravity excluded), which then passes: 1 ms in simulation.
  /// A command that breaks the contract latches a fault and the robot brakes; it is not applied.
  virtual void write(const JointVector& tau) noexcept = 0;

  /// The present cycle passes without a command: the last torque is used again; the 20th in a row
  /// is a fault.
  virtual void miss() noexcept = 0;

  /// Target distance between the finger tips, m. Returns at once; the gripper has its own speed.
  virtual void grip(double width) noexcept = 0;

  /// Ends the motion: the robot holds still on its own brakes and is idle after.
  virtual void stop() noexcept = 0;

  /// Clears a latched fault; the next write() starts a motion from zero torque. @returns false if
  /// the cause persists.
  virtual bool recover() noexcept = 0;
};

}  // namespace tandem
