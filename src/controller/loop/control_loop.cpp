#include "controller/loop/control_loop.h"

#include <algorithm>
#include <cmath>

namespace tandem {
namespace {

constexpr double kGripperStroke = 0.08;  // m, Franka Hand fully open

}  // namespace

ControlSettings read_control(Section section) {
  ControlSettings settings;
  settings.gains = read_gains(section.section("law"));
  Section reference = section.section("reference");
  settings.reference_omega = reference.number("omega_rad_s", 10.0, 500.0);
  const double linear = reference.number("acceleration_limit_m_s2", 0.1, 100.0);
  const double angular = reference.number("acceleration_limit_rad_s2", 0.1, 1000.0);
  settings.reference_acceleration << linear, linear, linear, angular, angular, angular;
  reference.finish();
  Section handover = section.section("handover");
  settings.ramp_in_ticks = static_cast<int>(handover.integer("ramp_in_ms", 1, 1000));
  settings.ramp_out_ticks = static_cast<int>(handover.integer("ramp_out_ms", 1, 1000));
  settings.teleop_hold_ms = static_cast<int>(handover.integer("hold_after_ms", 20, 10000));
  settings.teleop_release_ms = static_cast<int>(handover.integer("release_after_ms", 20, 60000));
  handover.finish();
  Section robot = section.section("robot");
  settings.robot.collision_force = robot.number("collision_force_N", 1.0, 1000.0);
  settings.robot.collision_torque.setConstant(robot.number("collision_torque_Nm", 1.0, 87.0));
  robot.finish();
  settings.force_filter_hz = section.number("force_filter_hz", 0.5, 400.0);
  section.finish();
  return settings;
}

ControlLoop::ControlLoop(Robot& robot, ArmModel& model, const TaskSpec& task,
                         const ControlSettings& settings, const ExecutionSettings& execution,
                         SpscRing<Record>& records)
    : robot_(robot),
      model_(model),
      task_(task),
      settings_(settings),
      records_(records),
      law_(settings.gains),
      reference_(settings.reference_omega, settings.reference_acceleration),
      executor_(execution, task.axes),
      arbiter_(settings.ramp_in_ticks, settings.ramp_out_ticks),
      force_filter_gain_(1.0 -
                         std::exp(-2.0 * 3.141592653589793 * settings.force_filter_hz * 0.001)) {}

void ControlLoop::begin_episode(const EpisodeBegin& episode, bool explore) noexcept {
  episode_ = episode;
  tick_ = 0;
  next_chunk_id_ = 0;
  human_ = HumanCommand{};
  human_held_ = false;
  gripper_ = 1.0;
  F_ext_.setZero();
  F_ext_filtered_.setZero();
  measure();
  F_ext_.setZero();
  F_ext_filtered_.setZero();
  X_WE_commanded_ = arm_.X_WE;
  reference_.reset(arm_.X_WE);
  executor_.begin_episode(episode.episode_seed, explore);
  arbiter_.reset(episode.phase == Phase::demonstration);
  human_.engaged = episode.phase == Phase::demonstration;
  record(episode);
}

void ControlLoop::measure() noexcept {
  const RobotState& robot = robot_.state();
  model_.update(robot.q, robot.dq, arm_);
  F_ext_ = external_wrench(arm_.J, robot.tau_external);
  F_ext_filtered_ += force_filter_gain_ * (F_ext_ - F_ext_filtered_);
}

StepSnapshot ControlLoop::begin_step(const SceneTruth& truth, int64_t utime) noexcept {
  const int32_t step = static_cast<int32_t>(tick_ / task_.ticks_per_step);
  StepSnapshot snapshot;
  snapshot.utime = utime;
  snapshot.episode = episode_.episode;
  snapshot.tick = tick_;
  snapshot.step = step;
  snapshot.phase = episode_.phase;
  snapshot.episode_seed = episode_.episode_seed;
  model_.update(robot_.state().q, robot_.state().dq, arm_);
  snapshot.X_WE = arm_.X_WE;
  snapshot.X_WE_commanded = X_WE_commanded_;
  snapshot.V_WE = arm_.V_WE;
  snapshot.F_ext_W = F_ext_filtered_;
  snapshot.gripper_width = robot_.state().gripper_width;
  snapshot.truth = truth;
  const bool policy_acts = episode_.phase != Phase::demonstration;
  snapshot.chunk_id = policy_acts && executor_.needs_chunk(step) ? next_chunk_id_++ : -1;

  step_ = StepRecord{};
  step_.utime = utime;
  step_.step = step;
  X_WE_commanded_at_step_ = X_WE_commanded_;
  alpha_sum_ = 0.0;
  return snapshot;
}

void ControlLoop::accept(const Chunk& chunk, int64_t observation_tick) noexcept {
  ChunkRecord taken{observation_tick, static_cast<int64_t>(chunk.start_step) * task_.ticks_per_step,
                    chunk};
  if (executor_.accept(chunk)) record(taken);
}

void ControlLoop::hear(const HumanCommand& command) noexcept {
  human_ = command;
  human_held_ = false;
  record(command);
}

void ControlLoop::human_silent(int64_t age_ms) noexcept {
  human_held_ = age_ms > settings_.teleop_hold_ms;
  if (age_ms > settings_.teleop_release_ms) human_.engaged = false;
}

Action ControlLoop::human_action() const noexcept {
  Action action = Action::Zero();
  if (!human_held_) action.head<6>() = human_.twist.cwiseProduct(task_.axes.head<6>());
  action[6] = task_.axes[6] != 0.0 ? human_.gripper : gripper_;
  return action;
}

void ControlLoop::move_commanded_pose(const Twist& increment) noexcept {
  // The commanded pose may lead the measured one by the error clip and no more: an increment that
  // would widen a lead beyond it is cut, so that nothing winds up while the arm is blocked. A lead
  // that is already there is left alone.
  const Twist lead = minus(X_WE_commanded_, arm_.X_WE);
  Twist allowed;
  for (int i = 0; i < 6; ++i) {
    const double clip = settings_.gains.error_clip[i];
    allowed[i] = increment[i] >= 0.0 ? std::min(increment[i], std::max(0.0, clip - lead[i]))
                                     : std::max(increment[i], std::min(0.0, -clip - lead[i]));
  }
  X_WE_commanded_ = add(X_WE_commanded_, allowed);
  X_WE_commanded_.p =
      X_WE_commanded_.p.cwiseMax(task_.workspace_low).cwiseMin(task_.workspace_high);
}

void ControlLoop::tick(int64_t utime) noexcept {
  measure();

  // Who asks for what, and how much each of them counts.
  const double alpha = arbiter_.step(human_.engaged);
  if (arbiter_.released()) executor_.invalidate();
  const Action policy = executor_.action(step_.step, gripper_);
  const Action human = human_action();
  const Action blended = (1.0 - alpha) * policy + alpha * human;

  // The gripper follows when the task lets it; else it stays as the task closed it.
  if (task_.axes[6] != 0.0) {
    gripper_ = blended[6];
    robot_.grip(0.5 * (1.0 - gripper_) * kGripperStroke);
  }

  // Commanded pose -> reference -> torque.
  move_commanded_pose(blended.head<6>().cwiseProduct(task_.action_limit) / task_.ticks_per_step);
  const PoseReference& reference = reference_.step(X_WE_commanded_);
  const JointVector tau =
      torque_filter_.limit(law_.torque(arm_, reference), robot_.state().tau_commanded);

  // What the record of this tick and of this step needs, before the robot moves on.
  if (Record* slot = records_.claim()) {
    TickRecord& now = slot->emplace<TickRecord>();
    now.utime = utime;
    now.tick = tick_;
    now.robot = robot_.state();
    now.X_WE = arm_.X_WE;
    now.X_WE_reference = reference.X_WE;
    now.V_WE = arm_.V_WE;
    now.F_ext_W = F_ext_filtered_;
    now.force_bound = law_.force_bound();
    now.tau_commanded = tau;
    now.alpha = alpha;
    records_.publish();
  } else {
    ++records_dropped_;
  }
  alpha_sum_ += alpha;
  step_.policy = policy;
  if (human_.engaged) step_.human = human;
  step_.intervention |= human_.engaged;
  step_.took_over |= arbiter_.took_over();
  if (executor_.chunk_id() >= 0) {
    step_.policy_version = executor_.policy_version();
    step_.chunk_id = executor_.chunk_id();
    step_.chunk_index = executor_.index(step_.step);
  }
  step_.force_peak = std::max(step_.force_peak, F_ext_.head<3>().norm());
  step_.force_filtered_peak = std::max(step_.force_filtered_peak, F_ext_filtered_.head<3>().norm());

  robot_.write(tau);
  ++tick_;
  ++ticks_;
}

StepRecord ControlLoop::end_step() noexcept {
  const Twist moved = minus(X_WE_commanded_, X_WE_commanded_at_step_);
  for (int i = 0; i < 6; ++i) {
    const double limit = task_.action_limit[i];
    step_.executed[i] = limit > 0.0 ? std::clamp(moved[i] / limit, -1.0, 1.0) : 0.0;
  }
  step_.executed[6] = gripper_;
  step_.alpha_mean = alpha_sum_ / task_.ticks_per_step;
  if (episode_.phase == Phase::demonstration) step_.policy.setZero();
  record(step_);
  return step_;
}

void ControlLoop::record(const Record& record) noexcept {
  if (!records_.push(record)) ++records_dropped_;
}

}  // namespace tandem
