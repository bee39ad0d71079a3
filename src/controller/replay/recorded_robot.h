#pragma once

#include "controller/robot/robot.h"

namespace tandem {

/// A robot that only remembers: its states come from a log, and what it is told is kept for
/// comparison.
class RecordedRobot final : public Robot {
 public:
  /// What the next tick reads.
  void show(const RobotState& state) noexcept { state_ = state; }
  /// What the last tick wrote, N m.
  const JointVector& written() const noexcept { return written_; }

  const RobotState& state() const noexcept override { return state_; }
  void write(const JointVector& tau) noexcept override { written_ = tau; }
  void miss() noexcept override {}
  void grip(double) noexcept override {}
  bool finish() noexcept override { return true; }
  void stop() noexcept override {}
  bool recover() noexcept override { return true; }

 private:
  RobotState state_;
  JointVector written_ = JointVector::Zero();
};

}  // namespace tandem
