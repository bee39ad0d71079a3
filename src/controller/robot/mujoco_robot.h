#pragma once

#include <bitset>
#include <cstdint>

#include "controller/robot/robot.h"
#include "controller/robot/simulation.h"

namespace tandem {

/// What can be chosen about the simulated robot.
struct MujocoRobotOptions {
  /// N m, filtered external torque that is a collision.
  JointVector collision_torque = JointVector::Constant(40.0);
  double collision_force = 80.0;  ///< N, filtered contact force that is a collision
  double gripper_speed = 0.1;     ///< m/s, of the width
  double gripper_force = 40.0;    ///< N, largest force of each finger
  double packet_loss = 0.0;       ///< share of commands lost on the way, [0, 1)
  uint64_t seed = 0;              ///< draws the lost commands
};

/// The FCI contract of robot.h on a Simulation: every cycle is one step of 1 ms.
///
/// As the real robot: gravity compensated; idle until the first write(), whose torque may change by
/// 1 N m from zero; the last torque used again in a missed cycle; the 20th consecutive miss, a
/// torque step over 1 N m (1000 N m/s), a torque out of range, a non-finite command, a joint beyond
/// its position or velocity limit, and a collision each latch a fault (the first one stays). Idle
/// or at fault the robot brakes with its own motors, within the torque limits, and then holds where
/// it came to rest.
///
/// Declared differences from the real robot:
/// - tau_external is exact (contacts and joint stops, no estimator) and unfiltered; collisions are
/// judged on a 20 ms average of it.
/// - tau_measured is the torque really applied; joints have viscous damping 1 N m s/rad and no dry
/// friction.
/// - Limits are judged after the step; there are no acceleration, jerk, power or self-collision
/// reflexes.
/// - The success rate counts over the cycles since the motion began until there are 100 of them.
class MujocoRobot final : public Robot {
 public:
  /// `simulation` must outlive the robot. @throws std::invalid_argument naming the option, its
  /// value and its range.
  explicit MujocoRobot(Simulation& simulation, const MujocoRobotOptions& options = {});

  const RobotState& state() const noexcept override { return state_; }
  void write(const JointVector& tau) noexcept override;
  void miss() noexcept override;
  void grip(double width) noexcept override;
  void stop() noexcept override;
  bool recover() noexcept override;

  /// Resets of a task, simulator only: as if someone had carried the arm to q and set the fingers
  /// `gripper_width` m apart. Ends the motion (idle, at rest) and passes no cycle; a latched fault
  /// stays until recover().
  void place(const JointVector& q, double gripper_width) noexcept;

  Simulation& simulation() noexcept { return simulation_; }

 private:
  void latch(Fault fault) noexcept;
  void end_motion(RobotMode mode) noexcept;
  void pass(const JointVector& tau) noexcept;
  void pass_braking() noexcept;
  void count(bool received) noexcept;
  void measure() noexcept;
  bool lost() noexcept;
  bool outside_position_limits() const noexcept;
  Eigen::Vector2d finger_force() noexcept;

  Simulation& simulation_;
  const MujocoRobotOptions options_;
  RobotState state_;
  JointVector hold_ = JointVector::Zero();             // rad, where the brakes hold
  JointVector filtered_torque_ = JointVector::Zero();  // N m, external
  double filtered_force_ = 0.0;                        // N, external
  double grip_target_ = 0.0, grip_reference_ = 0.0;    // m
  std::bitset<100> window_;                            // cycles with a command, a ring
  int window_next_ = 0, window_size_ = 0, misses_ = 0;
  uint64_t random_;
};

}  // namespace tandem
