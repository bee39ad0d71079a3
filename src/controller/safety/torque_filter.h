#pragma once

#include "base/geometry.h"

namespace tandem {

/// Last stage before the robot, on every path: finite, within the torque limits, within the torque
/// rate.
///
/// Limits: 87 N m (joints 1 to 4) and 12 N m (5 to 7), Franka's data sheet; 1000 N m/s, where the
/// robot trips, less a margin that absorbs rounding. A torque that is not finite becomes zero
/// torque and is counted: the arm then holds by its joint friction for the tick, and the caller
/// ends the episode as faulted. Real-time.
class TorqueFilter {
 public:
  /// Largest change of a joint torque from one tick to the next, N m.
  static constexpr double kStep = 1.0 - 1e-3;

  /// @param requested N m, from the law. @param previous N m, what the robot received last.
  JointVector limit(const JointVector& requested, const JointVector& previous) noexcept;

  int64_t not_finite_count() const noexcept { return not_finite_count_; }

  /// N m per joint.
  static JointVector torque_limit() noexcept;

 private:
  int64_t not_finite_count_ = 0;
};

}  // namespace tandem
