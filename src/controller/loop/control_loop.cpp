#include "controller/loop/control_loop.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/signal.h"

namespace tandem {
namespace {

// A gripper action less decided than this leaves the hand as it was told last. It is told to be
// open or closed and nothing between: half closed is no use to our tasks, and what is executed once
// is imitated.
constexpr double kGripperDecided = 0.3;

/// Of a gripper action: -1 open, 1 closed; m.
constexpr double gripper_width(double action) { return 0.5 * (1.0 - action) * kGripperStroke; }

// By so much a tick the commanded pose comes to a damped arm, m and rad.
constexpr double kFollow = 0.0002, kFollowAngle = 0.002;

// Equal bits, equal digest; any other bit changes it.
uint64_t digest(uint64_t hash, const JointVector& tau) noexcept {
  for (int i = 0; i < 7; ++i) {
    hash = (hash ^ std::bit_cast<uint64_t>(tau[i])) * 0x9e3779b97f4a7c15ull;
    hash ^= hash >> 32;
  }
  return hash;
}

}  // namespace

ControlLoop::ControlLoop(Robot& robot, ArmModel& model, const TaskSpec& task,
                         const ControlSettings& settings, const ExecutionSettings& execution,
                         SpscRing<Record>& records)
    : robot_(robot),
      model_(model),
      task_(task),
      settings_(settings),
      records_(records),
      law_(settings.gains),
      reference_(settings.reference),
      executor_(execution, task.axes, task.ticks_per_step),
      arbiter_(settings.ramp_in_ticks, settings.ramp_out_ticks),
      safety_(settings.safety, model, task.workspace_low, task.workspace_high),
      force_filter_gain_(1.0 -
                         std::exp(-2.0 * 3.141592653589793 * settings.force_filter_hz * 0.001)),
      latency_ticks_(execution.latency_ticks) {}

void ControlLoop::begin_episode(const EpisodeBegin& episode) noexcept {
  episode_ = episode;
  tick_ = 0;
  next_chunk_id_ = 0;
  kept_back_.reset();
  fault_ = Fault::none;
  label_ = 0;
  grades_.fill(Grade::fresh);
  human_ = HumanCommand{};
  gripper_ = task_.gripper_start;
  measure();
  F_ext_.setZero();
  F_ext_filtered_.setZero();
  X_WE_commanded_ = arm_.X_WE;
  law_.reset();
  reference_.reset(arm_.X_WE);
  executor_.begin_episode(episode.episode_seed, episode.phase == Phase::training);
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
  snapshot.gripper_commanded = gripper_width(gripper_);
  snapshot.truth = truth;
  snapshot.chunk_id = episode_.has_policy && executor_.needs_chunk(step) ? next_chunk_id_++ : -1;

  step_ = StepRecord{};
  step_.utime = utime;
  step_.step = step;
  X_WE_commanded_at_step_ = X_WE_commanded_;
  alpha_sum_ = 0.0;
  return snapshot;
}

void ControlLoop::accept(const Chunk& chunk) noexcept {
  if (tick_ < chunk.observation_tick + latency_ticks_) {
    kept_back_ = chunk;
  } else {
    take_over(chunk);
  }
}

void ControlLoop::take_over(const Chunk& chunk) noexcept {
  const Verdict verdict = executor_.accept(chunk, tick_);
  if (verdict != Verdict::taken && verdict != Verdict::taken_late) return;
  record(ChunkRecord{static_cast<int64_t>(chunk.start_step) * task_.ticks_per_step, tick_, chunk});
}

void ControlLoop::hear(const HumanCommand& command, int64_t utime) noexcept {
  human_ = command;
  human_heard_us_ = utime;
  // A verdict counts for the episode that it was given on; a device that does not look gives it on
  // the running one.
  const bool this_episode =
      command.episode_answered < 0 || command.episode_answered == episode_.episode;
  if (label_ == 0 && this_episode) label_ = command.label;
  record(command);
}

void ControlLoop::set_gains(const ImpedanceGains& gains, int64_t utime) noexcept {
  law_.set_gains(gains);
  record(GainsRecord{utime, gains});
}

void ControlLoop::stop(Fault fault) noexcept {
  if (fault_ == Fault::none) fault_ = fault;
  robot_.stop();
}

void ControlLoop::grade_sources(const TickInput& input) noexcept {
  const auto age_ms = [&](int64_t since_us) {
    return 1e-3 * static_cast<double>(input.utime - since_us);
  };
  const WatchdogSettings& watchdog = settings_.watchdog;
  if (human_.engaged && episode_.has_policy &&
      age_ms(human_heard_us_) > watchdog.operator_release_after_ms) {
    human_.engaged = false;
  }
  const bool policy_in_charge = episode_.has_policy && !human_.engaged;
  if (!policy_in_charge || executor_.due(step_.step)) action_due_us_ = input.utime;
  if (action_due_us_ != input.utime) ++starved_ticks_;

  grades_[0] = watchdog.policy.grade(age_ms(action_due_us_));
  grades_[1] = human_.engaged ? watchdog.operator_.grade(age_ms(human_heard_us_)) : Grade::fresh;
  grades_[2] = watchdog.link.grade(input.link_age_ms);
}

Action ControlLoop::human_action() const noexcept {
  Action action = Action::Zero();
  if (grades_[1] == Grade::fresh)
    action.head<6>() = human_.twist.cwiseProduct(task_.axes.head<6>());
  action[6] = task_.axes[6] != 0.0 ? human_.gripper : gripper_;
  return action;
}

// By how much the commanded pose should move in this tick, base axes.
Twist ControlLoop::wanted_increment(const Action& blended) const noexcept {
  const Grade worst = *std::max_element(grades_.begin(), grades_.end());
  if (worst >= Grade::damp) {
    // Whoever pushes the arm takes the commanded pose along, so that it does not spring back.
    Twist reach;
    reach << kFollow, kFollow, kFollow, kFollowAngle, kFollowAngle, kFollowAngle;
    return minus(arm_.X_WE, X_WE_commanded_).cwiseMax(-reach).cwiseMin(reach);
  }
  if (grades_[2] == Grade::hold) return Twist::Zero();
  return blended.head<6>().cwiseProduct(task_.action_limit) / task_.ticks_per_step;
}

// The commanded pose may lead the measured one by the error clip and no more: an increment that
// would widen a lead beyond it is cut, so that nothing winds up while the arm is blocked.
void ControlLoop::move_commanded_pose(const Twist& increment) noexcept {
  const Twist lead = minus(X_WE_commanded_, arm_.X_WE);
  X_WE_commanded_ = add(X_WE_commanded_, law_.allowed(increment, lead, arm_.X_WE.R));
  X_WE_commanded_.p =
      X_WE_commanded_.p.cwiseMax(task_.workspace_low).cwiseMin(task_.workspace_high);
}

void ControlLoop::tick(const TickInput& input) noexcept {
  if (fault_ != Fault::none) return robot_.miss();  // its brakes have the arm
  if (robot_.state().fault != Fault::none) return stop(robot_.state().fault);
  measure();
  if (tick_ == 0) human_heard_us_ = action_due_us_ = input.utime;
  if (kept_back_ && tick_ >= kept_back_->observation_tick + latency_ticks_) {
    take_over(*kept_back_);
    kept_back_.reset();
  }

  // Who asks for what, and how much each of them counts.
  grade_sources(input);
  const double alpha = arbiter_.step(human_.engaged);
  if (arbiter_.released()) executor_.invalidate(tick_);
  const Action policy = executor_.action(step_.step, gripper_);
  const Action human = human_action();
  const Action blended = (1.0 - alpha) * policy + alpha * human;

  // The gripper opens or closes when the task lets it; else it stays as the task closed it.
  if (task_.axes[6] != 0.0) {
    if (std::abs(blended[6]) > kGripperDecided) gripper_ = std::copysign(1.0, blended[6]);
    robot_.grip(gripper_width(gripper_));
  }

  // Commanded pose -> reference -> torque.
  move_commanded_pose(wanted_increment(blended));
  law_.set_damped(*std::max_element(grades_.begin(), grades_.end()) >= Grade::damp);
  const PoseReference& reference = reference_.step(X_WE_commanded_);
  const JointVector tau =
      safety_.limit(arm_, law_.torque(arm_, reference), robot_.state().tau_commanded);

  // The record of this tick and of this step, before the robot moves on.
  note(input, tau);
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
  step_.torque_digest = digest(step_.torque_digest, tau);

  computed_ns_ = monotonic_ns();
  robot_.write(tau);
  ++tick_;
  ++ticks_;

  // What ends the motion.
  constexpr Fault kSilent[3] = {Fault::policy_silent, Fault::operator_silent, Fault::link_silent};
  if (robot_.state().fault != Fault::none) return stop(robot_.state().fault);
  if (safety_.acted() & SafetyFilter::not_finite) return stop(Fault::not_finite);
  for (int source = 0; source < 3; ++source) {
    if (grades_[source] == Grade::stop) return stop(kSilent[source]);
  }
}

void ControlLoop::note(const TickInput& input, const JointVector& tau) noexcept {
  Record* slot = records_.claim();
  if (!slot) {
    ++records_dropped_;
    return;
  }
  TickRecord& now = slot->emplace<TickRecord>();
  now.input = input;
  now.tick = tick_;
  now.robot = robot_.state();
  now.X_WE = arm_.X_WE;
  now.X_WE_reference = reference_.reference().X_WE;
  now.V_WE = arm_.V_WE;
  now.F_ext_W = F_ext_filtered_;
  now.force_bound = law_.force_bound(arm_.X_WE.R);
  now.tau_commanded = tau;
  now.alpha = arbiter_.alpha();
  now.limits_acted = safety_.acted();
  records_.publish();
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
