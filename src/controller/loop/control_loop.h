#pragma once

#include <optional>

#include "base/spsc_ring.h"
#include "controller/chunk/chunk_executor.h"
#include "controller/chunk/reference_filter.h"
#include "controller/episode/record.h"
#include "controller/law/cartesian_impedance.h"
#include "controller/robot/mujoco_robot.h"
#include "controller/safety/torque_filter.h"
#include "controller/task/task.h"
#include "intervention/arbiter.h"

namespace tandem {

/// The `controller` section of the scenario, apart from the law's gains. See config/controller.yaml
/// for units and reasons.
struct ControlSettings {
  ImpedanceGains gains;
  double reference_omega = 0.0;  ///< rad/s
  Twist reference_acceleration;  ///< m/s^2, rad/s^2
  double force_filter_hz = 0.0;  ///< cut-off of the wrench that observation and operator see
  int ramp_in_ticks = 1, ramp_out_ticks = 1;
  MujocoRobotOptions robot;                       ///< reflex thresholds
  int teleop_hold_ms = 0, teleop_release_ms = 0;  ///< real time: age of the human's last word
};

/// @throws ScenarioError
ControlSettings read_control(Section section);

/// The 1 kHz loop: the way of an action from chunk to torque.
///
///   chunk -> action due -> blend with the human (increments) -> commanded pose (lead and box
///   limits)
///         -> reference filter -> impedance law -> torque filter -> robot -> record
///
/// The caller owns time: it calls begin_step(), tick() x ticks_per_step, end_step(), and hands
/// chunks and human commands over in between. Nothing here allocates, locks, logs or throws; a
/// record that finds the ring full is dropped and counted.
class ControlLoop {
 public:
  ControlLoop(Robot& robot, ArmModel& model, const TaskSpec& task, const ControlSettings& settings,
              const ExecutionSettings& execution, SpscRing<Record>& records);

  /// Commanded pose, reference and authority start from where the arm is.
  void begin_episode(const EpisodeBegin& episode, bool explore) noexcept;

  /// A policy step begins. @param utime us. The snapshot says whether an inference is due (chunk_id
  /// >= 0).
  StepSnapshot begin_step(const SceneTruth& truth, int64_t utime) noexcept;

  /// A new chunk; its record is kept with the tick at which it took effect.
  void accept(const Chunk& chunk, int64_t observation_tick) noexcept;

  /// The human's latest word. It stays in force until the next.
  void hear(const HumanCommand& command) noexcept;

  /// Nothing was heard from the human for `age_ms` (real time): first his motion is held, then he
  /// is taken as gone.
  void human_silent(int64_t age_ms) noexcept;

  /// One millisecond.
  void tick(int64_t utime) noexcept;

  /// The policy step ends. @returns its record, which is also pushed.
  StepRecord end_step() noexcept;

  /// Pushes any other record.
  void record(const Record& record) noexcept;

  const RobotState& robot_state() const noexcept { return robot_.state(); }
  const ArmState& arm() const noexcept { return arm_; }
  const Pose& commanded_pose() const noexcept { return X_WE_commanded_; }
  double alpha() const noexcept { return arbiter_.alpha(); }
  const HumanCommand& human() const noexcept { return human_; }
  int64_t ticks() const noexcept { return ticks_; }
  int64_t records_dropped() const noexcept { return records_dropped_; }
  int64_t not_finite_count() const noexcept { return torque_filter_.not_finite_count(); }

 private:
  void measure() noexcept;
  void move_commanded_pose(const Twist& increment) noexcept;
  Action human_action() const noexcept;

  Robot& robot_;
  ArmModel& model_;
  const TaskSpec& task_;
  ControlSettings settings_;
  SpscRing<Record>& records_;

  CartesianImpedance law_;
  ReferenceFilter reference_;
  ChunkExecutor executor_;
  Arbiter arbiter_;
  TorqueFilter torque_filter_;

  ArmState arm_;
  Pose X_WE_commanded_;
  HumanCommand human_;
  bool human_held_ = false;
  Wrench F_ext_ = Wrench::Zero(), F_ext_filtered_ = Wrench::Zero();
  double force_filter_gain_ = 1.0, gripper_ = 1.0;

  EpisodeBegin episode_;
  int64_t tick_ = 0, ticks_ = 0, records_dropped_ = 0;
  int32_t next_chunk_id_ = 0;
  Pose X_WE_commanded_at_step_;
  StepRecord step_;
  double alpha_sum_ = 0.0;
};

}  // namespace tandem
