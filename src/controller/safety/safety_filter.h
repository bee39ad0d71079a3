#pragma once

#include <array>
#include <cstdint>

#include "base/section.h"
#include "controller/law/arm_model.h"

namespace tandem {

/// The `safety` section. Ranges and reasons: config/controller.yaml.
struct SafetySettings {
  double wall_stiffness = 0.0;    ///< N/m
  double wall_force_limit = 0.0;  ///< N per axis
  double joint_margin = 0.0;      ///< rad before a position limit where repulsion begins
  double joint_repulsion = 0.0;   ///< N m at the limit
  double velocity_margin = 0.0;   ///< share of a joint's velocity limit where braking begins
};

/// @throws ScenarioError
SafetySettings read_safety(Section section);

/// Last stage before the robot, on every path: what leaves it is finite, within the torque limits
/// and within the torque rate, whatever goes in; and it pushes back where the arm must not go.
///
///   soft wall        the measured tool position outside of the workspace box is pushed back (J'
///   F),
///                    harder while it still moves outwards
///   joint position   within the margin before a limit a repulsion grows to `joint_repulsion`, and
///                    what drives the joint to the limit is taken away: at the limit all of it
///   joint velocity   above the margin's share of the limit a braking torque grows, and what drives
///                    the joint faster is taken away: at the limit all of it
///   torque           87 N m (joints 1 to 4), 12 N m (5 to 7), Franka's data sheet
///   torque rate      1000 N m/s, where the robot trips, less a margin that absorbs rounding
///
/// Each of them is continuous in its cause and exactly zero away from its limit. A request or a
/// measurement that is not finite becomes damping torque and is counted; the caller ends the
/// episode. The rate limit comes last and outranks the others: within one tick a joint's torque
/// turns by 1 N m and no more.
///
/// Real-time: no allocation, no lock, noexcept.
class SafetyFilter {
 public:
  /// Bits of acted(), and in this order the entries of counts().
  enum Limit : uint32_t {
    not_finite = 1,
    wall = 2,
    joint_position = 4,
    joint_velocity = 8,
    torque = 16,
    torque_rate = 32
  };

  /// Largest change of a joint torque from one tick to the next, N m.
  static constexpr double kStep = 1.0 - 1e-3;

  /// @param model gives the joints' limits. The box is in W, m.
  SafetyFilter(const SafetySettings& settings, const ArmModel& model,
               const Eigen::Vector3d& workspace_low, const Eigen::Vector3d& workspace_high);

  /// @param requested N m, from the law. @param previous N m, what the robot received last.
  JointVector limit(const ArmState& arm, const JointVector& requested,
                    const JointVector& previous) noexcept;

  /// Limits that changed the torque in the latest call.
  uint32_t acted() const noexcept { return acted_; }
  /// Calls in which each limit acted.
  const std::array<int64_t, 6>& counts() const noexcept { return counts_; }
  int64_t not_finite_count() const noexcept { return counts_[0]; }

  /// N m per joint.
  static JointVector torque_limit() noexcept;

 private:
  void push_back_from_walls(const ArmState& arm, JointVector& tau) noexcept;
  void keep_within_positions(const ArmState& arm, JointVector& tau) noexcept;
  void keep_within_velocities(const ArmState& arm, JointVector& tau) noexcept;

  SafetySettings settings_;
  JointVector lower_, upper_, velocity_;
  Eigen::Vector3d workspace_low_, workspace_high_;
  uint32_t acted_ = 0;
  std::array<int64_t, 6> counts_{};
};

}  // namespace tandem
