#pragma once

#include <array>
#include <cstdint>

#include "base/geometry.h"
#include "controller/robot/fault.h"

/// The robot as Franka's control interface (FCI) shows it: one torque command per 1 ms cycle.
namespace tandem {

/// m between the finger tips, Franka Hand fully open.
inline constexpr double kGripperStroke = 0.08;

enum class RobotMode : int8_t { idle = 0, moving = 1, reflex = 2, user_stopped = 3 };

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
      JointVector::Zero();  ///< N m, + = environment pushes the joint forward; unfiltered
  /// -1 0 1: sign of the external torque where its average over 20 ms is beyond the contact
  /// threshold.
  std::array<int8_t, 7> contact_joint{};
  std::array<int8_t, 6> contact_W{};  ///< the same of force and moment on the tool, base axes
  double gripper_width = 0.0;         ///< m
  double success_rate = 0.0;          ///< share of the last 100 cycles with a command, 0 while idle
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

  /// Target distance between the finger tips, m. Returns at once; the gripper has its own latency,
  /// speed and force. To repeat a target changes nothing.
  virtual void grip(double width) noexcept = 0;

  /// Asks for the end of the motion, in place of write(), once per cycle until it returns true:
  /// the robot brakes, still `moving`, and answers with idle when it stands. The present cycle
  /// passes. Silence before that counts as misses, and so does a write(): an end asked for is not
  /// withdrawn.
  /// @returns whether the motion is over: idle, or a latched fault (finish_timeout after 1 s).
  virtual bool finish() noexcept = 0;

  /// Ends the motion at once, without handshake: the robot brakes, then holds still; idle.
  virtual void stop() noexcept = 0;

  /// Clears a latched fault; the next write() starts a motion from zero torque. @returns false,
  /// and changes nothing, while the arm still moves or the cause persists.
  virtual bool recover() noexcept = 0;
};

}  // namespace tandem
