#pragma once

#include <array>
#include <bitset>
#include <cstdint>

#include "controller/robot/robot.h"
#include "controller/robot/robot_options.h"
#include "controller/robot/simulation.h"

namespace tandem {

/// The FCI contract of robot.h on a Simulation: every cycle is one step of 1 ms.
///
/// As the real robot: gravity compensated; idle until the first write(), whose torque may change by
/// 1 N m from zero; the last torque used again in a missed cycle. The first of these latches its
/// fault, and the robot brakes: the 20th consecutive miss, a torque step over 1 N m (1000 N m/s), a
/// torque out of range, a non-finite command, a joint beyond its position or velocity limit, the
/// tool faster than 1.7 m/s or 2.5 rad/s, a collision, the stop button, an arm that still moves 1 s
/// after finish(). Whenever it is not moving the robot brakes with its own motors, within the
/// torque limits, and then holds where it came to rest.
///
/// Declared differences from the real robot:
/// - tau_external is exact (contacts, joint stops, pushes; no estimator) and unfiltered; contact
/// and collision are judged on a 20 ms average of it and of the exact wrench on the tool.
/// - tau_measured is the torque really applied; joints have viscous damping 1 N m s/rad and no dry
/// friction.
/// - Limits are judged after the step; there are no acceleration, jerk, power or self-collision
/// reflexes, and none but the stop button while the robot is not moving.
/// - The success rate counts over the cycles since the motion began until there are 100 of them.
/// - The stop button is latched: after its release recover() is needed.
class MujocoRobot final : public Robot {
 public:
  /// `simulation` must outlive the robot. @throws std::invalid_argument naming the option, its
  /// value and its range.
  explicit MujocoRobot(Simulation& simulation, const MujocoRobotOptions& options = {});

  const RobotState& state() const noexcept override { return state_; }
  void write(const JointVector& tau) noexcept override;
  void miss() noexcept override;
  void grip(double width) noexcept override;
  bool finish() noexcept override;
  void stop() noexcept override;
  bool recover() noexcept override;

  /// Resets of a task, simulator only: as if someone had carried the arm to q and set the fingers
  /// `gripper_width` m apart. Ends the motion (idle, at rest) and any push, and passes no cycle; a
  /// latched fault stays until recover().
  void place(const JointVector& q, double gripper_width) noexcept;

  /// The robot's own stop button. Pressed, it latches Fault::user_stop in any mode (an earlier
  /// fault stays) and no recover() succeeds; released, recover() is still needed.
  void press_stop(bool pressed) noexcept;

  /// Somebody pushes the tool for `ms` cycles: N at E, W axes. A new push replaces the present one.
  void push(const Eigen::Vector3d& force_W, int ms) noexcept;

  /// Replaces what goes wrong at random. @throws std::invalid_argument naming the value and its
  /// range.
  void inject(const Injection& injection) { injection_ = FaultInjection(injection); }

  /// Call when an episode begins: what goes wrong in it depends on this seed alone.
  void seed_faults(uint64_t episode_seed) noexcept { injection_.seed(episode_seed); }

  const InjectionCounts& injected() const noexcept { return injection_.counts(); }

  Simulation& simulation() noexcept { return simulation_; }

 private:
  bool disturbed() noexcept;
  void skip() noexcept;
  void latch(Fault fault) noexcept;
  void end_motion(RobotMode mode) noexcept;
  void pass(const JointVector& tau) noexcept;
  void pass_braking() noexcept;
  void pass_finishing() noexcept;
  void judge_contact() noexcept;
  Fault reflex() const noexcept;
  void count(bool received) noexcept;
  void measure() noexcept;
  void forget_contact() noexcept;
  void end_push() noexcept;
  bool outside_position_limits() const noexcept;
  bool at_rest() const noexcept;
  Eigen::Vector2d finger_force() noexcept;

  Simulation& simulation_;
  const MujocoRobotOptions options_;
  FaultInjection injection_;
  RobotState state_;
  bool stop_pressed_ = false;

  JointVector hold_ = JointVector::Zero();             // rad, where the brakes hold
  JointVector filtered_torque_ = JointVector::Zero();  // N m, external
  Wrench filtered_wrench_ = Wrench::Zero();            // N, N m, external, on the tool

  Eigen::Vector3d push_force_W_ = Eigen::Vector3d::Zero();  // N
  int push_left_ = 0;                                       // cycles

  // m: what grip() was told last, what the gripper heard of it, on its way through the latency
  // (a ring over cycles), and where the fingers are led now.
  double grip_told_ = 0.0, grip_heard_ = 0.0, grip_reference_ = 0.0;
  std::array<double, kLongestGripperLatencyMs + 1> grip_delay_{};

  std::bitset<100> window_;  // cycles with a command, a ring
  int window_next_ = 0, window_size_ = 0, misses_ = 0;
  bool finishing_ = false;
  int finish_cycles_ = 0, resting_cycles_ = 0;
};

}  // namespace tandem
