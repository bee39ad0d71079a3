#pragma once

#include <array>
#include <optional>

#include "base/spsc_ring.h"
#include "controller/chunk/chunk_executor.h"
#include "controller/chunk/reference_filter.h"
#include "controller/episode/record.h"
#include "controller/law/cartesian_impedance.h"
#include "controller/loop/control_settings.h"
#include "controller/safety/safety_filter.h"
#include "controller/safety/watchdog.h"
#include "controller/task/task.h"
#include "intervention/arbiter.h"

namespace tandem {

/// The 1 kHz loop: the way of an action from chunk to torque.
///
///   chunk -> action due -> blend with the human (increments) -> commanded pose (lead and box
///   limits) -> reference filter -> impedance law -> safety filter -> robot -> record
///
/// Its caller owns time: it calls begin_step(), tick() x ticks_per_step, end_step(), and hands
/// chunks, gains and human commands over in between. What a tick computes depends on nothing but
/// these calls and the robot's states, so a log that holds both can be computed again to the bit.
///
/// A source that falls silent is answered by grades (WatchdogSettings): its motion is held, then
/// the stiffness fades, then the robot is stopped with a fault. A silent human who has the arm is
/// taken as gone when there is a policy to hand back to.
///
/// Nothing here allocates, locks, logs or throws; a record that finds the ring full is dropped and
/// counted.
class ControlLoop {
 public:
  ControlLoop(Robot& robot, ArmModel& model, const TaskSpec& task, const ControlSettings& settings,
              const ExecutionSettings& execution, SpscRing<Record>& records);

  /// Commanded pose, reference and authority start from where the arm is. Silence of the sources
  /// counts from the first tick.
  void begin_episode(const EpisodeBegin& episode) noexcept;

  /// A policy step begins. @param utime us. The snapshot says whether an inference is due (chunk_id
  /// >= 0).
  StepSnapshot begin_step(const SceneTruth& truth, int64_t utime) noexcept;

  /// A new chunk takes over in the next tick, or is refused and counted. In lockstep it is kept
  /// back until it is as old as the modelled latency (ExecutionSettings).
  void accept(const Chunk& chunk) noexcept;

  /// The human's latest word. It stays in force until the next, or until he has been silent for too
  /// long. @param utime us, of the tick that follows.
  void hear(const HumanCommand& command, int64_t utime) noexcept;

  /// Checked gains, ramped in from the next tick. @param utime us, of the tick that follows.
  void set_gains(const ImpedanceGains& gains, int64_t utime) noexcept;

  /// One millisecond.
  void tick(const TickInput& input) noexcept;

  /// Ends the motion now, from outside of a tick, with a fault that stays until begin_episode().
  void stop(Fault fault) noexcept;

  /// The policy step ends. @returns its record, which is also pushed.
  StepRecord end_step() noexcept;

  /// Pushes any other record.
  void record(const Record& record) noexcept;

  /// Why the motion is over, or none: the robot's own fault or the controller's. The first one
  /// stays until begin_episode().
  Fault fault() const noexcept { return fault_; }

  /// The human's verdict on this episode, LABEL_NONE until he gives one; the first one stays.
  int8_t label() const noexcept { return label_; }

  const RobotState& robot_state() const noexcept { return robot_.state(); }
  const ArmState& arm() const noexcept { return arm_; }
  const Pose& commanded_pose() const noexcept { return X_WE_commanded_; }
  const PoseReference& reference() const noexcept { return reference_.reference(); }
  double alpha() const noexcept { return arbiter_.alpha(); }
  const HumanCommand& human() const noexcept { return human_; }
  const ChunkExecutor& executor() const noexcept { return executor_; }
  const CartesianImpedance& law() const noexcept { return law_; }
  const SafetyFilter& safety() const noexcept { return safety_; }

  /// Of policy, operator and link, in the latest tick.
  const std::array<Grade, 3>& grades() const noexcept { return grades_; }
  int64_t starved_ticks() const noexcept { return starved_ticks_; }
  /// When the latest tick had its torque ready, monotonic ns: what follows is the robot's time.
  int64_t computed_ns() const noexcept { return computed_ns_; }
  int64_t ticks() const noexcept { return ticks_; }
  int64_t records_dropped() const noexcept { return records_dropped_; }

 private:
  void measure() noexcept;
  void take_over(const Chunk& chunk) noexcept;
  void grade_sources(const TickInput& input) noexcept;
  Twist wanted_increment(const Action& blended) const noexcept;
  void move_commanded_pose(const Twist& increment) noexcept;
  Action human_action() const noexcept;
  void note(const TickInput& input, const JointVector& tau) noexcept;

  Robot& robot_;
  ArmModel& model_;
  const TaskSpec& task_;
  ControlSettings settings_;
  SpscRing<Record>& records_;

  CartesianImpedance law_;
  ReferenceFilter reference_;
  ChunkExecutor executor_;
  Arbiter arbiter_;
  SafetyFilter safety_;

  ArmState arm_;
  Pose X_WE_commanded_;
  HumanCommand human_;
  int64_t human_heard_us_ = 0, action_due_us_ = 0;
  std::array<Grade, 3> grades_{};
  Fault fault_ = Fault::none;
  int8_t label_ = 0;
  Wrench F_ext_ = Wrench::Zero(), F_ext_filtered_ = Wrench::Zero();
  double force_filter_gain_ = 1.0, gripper_ = 1.0;

  EpisodeBegin episode_;
  int64_t computed_ns_ = 0;
  int64_t tick_ = 0, ticks_ = 0, starved_ticks_ = 0, records_dropped_ = 0;
  int32_t next_chunk_id_ = 0;
  const int32_t latency_ticks_;
  std::optional<Chunk> kept_back_;
  Pose X_WE_commanded_at_step_;
  StepRecord step_;
  double alpha_sum_ = 0.0;
};

}  // namespace tandem
