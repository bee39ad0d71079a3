#include "controller/robot/mujoco_robot.h"

#include <algorithm>
#include <cmath>

namespace tandem {
namespace {

constexpr int kMissesToFault = 20;
constexpr int kWindow = 100;
// Nominal: 1000 N m/s at 1 kHz. A limiter aims a little below (999.999 N m/s), so that rounding
// never trips the robot.
constexpr double kTorqueStep = 1000.0 * Simulation::kTimeStep;
constexpr double kToolSpeed = 1.7, kToolTurn = 2.5;  // m/s, rad/s, FER
constexpr double kFilter = 0.05;                     // of a new value in the contact filter: 20 ms
constexpr double kBrakesHold = 0.1;                  // rad/s, below which they hold the position
constexpr double kStandstill = 0.005;                // rad/s of every joint
constexpr int kRestingCycles = 10;                   // of standstill end a motion
constexpr int kFinishTimeout = 1000;                 // cycles
constexpr double kFingerStiffness = 4000.0,
                 kFingerDamping = 40.0;  // N/m, N s/m, of the width, a finger
constexpr double kCouplingStiffness = 10000.0,
                 kCouplingDamping = 60.0;  // the fingers' gear: keeps them symmetric

JointVector make(double a, double b, double c, double d, double e, double f, double g) {
  JointVector v;
  v << a, b, c, d, e, f, g;
  return v;
}

const JointVector kTorqueLimit = make(87, 87, 87, 87, 12, 12, 12);  // N m, FER
const JointVector kVelocityLimit =
    make(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61);                              // rad/s, FER
const JointVector kBrakeStiffness = make(2500, 2500, 2500, 2500, 1000, 1000, 1000);  // N m/rad
const JointVector kBrakeDamping = make(100, 100, 100, 100, 30, 30, 30);              // N m s/rad

int8_t beyond(double value, double threshold) {
  return static_cast<int8_t>((value > threshold) - (value < -threshold));
}

}  // namespace

MujocoRobot::MujocoRobot(Simulation& simulation, const MujocoRobotOptions& options)
    : simulation_(simulation), options_(options), injection_(options.inject) {
  check(options);
  place(simulation.q(), simulation.finger_position().sum());
}

//------------------------------ commands ------------------------------

void MujocoRobot::write(const JointVector& tau) noexcept {
  if (finishing_) return miss();
  if (state_.mode != RobotMode::idle && state_.mode != RobotMode::moving) return pass_braking();
  if (disturbed()) return pass_braking();

  // On the way to the robot.
  const bool lost = injection_.loses_command();
  JointVector received = tau;
  injection_.corrupt(received);
  if (lost) return skip();

  if (!received.allFinite()) {
    latch(Fault::not_finite);
  } else if (((received - state_.tau_commanded).cwiseAbs().array() > kTorqueStep).any()) {
    latch(Fault::torque_discontinuity);
  } else if ((received.cwiseAbs().array() > kTorqueLimit.array()).any()) {
    latch(Fault::torque_range);
  }
  if (state_.fault != Fault::none) return pass_braking();
  state_.mode = RobotMode::moving;
  state_.tau_commanded = received;
  count(true);
  pass(received);
}

void MujocoRobot::miss() noexcept {
  if (state_.mode != RobotMode::moving || disturbed()) return pass_braking();
  skip();
}

bool MujocoRobot::finish() noexcept {
  if (state_.mode != RobotMode::moving || disturbed()) {
    pass_braking();
    return true;
  }
  if (injection_.loses_command()) {
    skip();
    return state_.mode != RobotMode::moving;
  }
  if (!finishing_) hold_ = state_.q;
  finishing_ = true;
  count(true);
  pass_finishing();
  return state_.mode != RobotMode::moving;
}

// The cycle of a command that did not come.
void MujocoRobot::skip() noexcept {
  if (state_.mode != RobotMode::moving) return pass_braking();
  count(false);
  if (misses_ >= kMissesToFault) {
    latch(Fault::communication_constraints_violation);
    pass_braking();
  } else if (finishing_) {
    pass_finishing();
  } else {
    pass(state_.tau_commanded);
  }
}

void MujocoRobot::grip(double width) noexcept {
  if (!std::isfinite(width)) return;
  width = std::clamp(width, 0.0, kGripperStroke);
  if (width == grip_told_) return;
  grip_told_ = width;
  if (!injection_.misses_grip()) grip_heard_ = width;
}

void MujocoRobot::stop() noexcept {
  if (state_.mode == RobotMode::moving) end_motion(RobotMode::idle);
}

bool MujocoRobot::recover() noexcept {
  if (state_.fault == Fault::none) return true;
  if (stop_pressed_ || outside_position_limits() || !at_rest()) return false;
  state_.fault = Fault::none;
  state_.mode = RobotMode::idle;
  forget_contact();
  return true;
}

void MujocoRobot::place(const JointVector& q, double gripper_width) noexcept {
  end_push();
  simulation_.set_arm(q, gripper_width);
  grip_told_ = grip_heard_ = grip_reference_ = gripper_width;
  grip_delay_.fill(gripper_width);
  forget_contact();
  state_.tau_measured.setZero();
  if (state_.mode == RobotMode::moving) end_motion(RobotMode::idle);
  hold_ = q;
  measure();
}

//------------------------------ from outside ------------------------------

void MujocoRobot::press_stop(bool pressed) noexcept {
  stop_pressed_ = pressed;
  if (!pressed) return;
  latch(Fault::user_stop);
  state_.mode = RobotMode::user_stopped;
}

void MujocoRobot::push(const Eigen::Vector3d& force_W, int ms) noexcept {
  push_force_W_ = force_W;
  push_left_ = ms;
}

void MujocoRobot::end_push() noexcept {
  push_left_ = 0;
  simulation_.push(Wrench::Zero());
}

// Draws what happens to the robot in this cycle. @returns whether it has ended the motion.
bool MujocoRobot::disturbed() noexcept {
  Eigen::Vector3d force_W;
  if (push_left_ == 0 && injection_.pushes(force_W)) push(force_W, injection_.push_ms());
  if (!injection_.stops()) return false;
  press_stop(true);
  press_stop(false);
  return true;
}

//------------------------------ ends of a motion ------------------------------

// The first fault stays: what follows from it says nothing.
void MujocoRobot::latch(Fault fault) noexcept {
  if (state_.fault == Fault::none) state_.fault = fault;
  end_motion(RobotMode::reflex);
}

void MujocoRobot::end_motion(RobotMode mode) noexcept {
  state_.mode = mode;
  state_.tau_commanded.setZero();
  state_.success_rate = 0.0;
  window_.reset();
  window_next_ = window_size_ = misses_ = 0;
  finishing_ = false;
  finish_cycles_ = resting_cycles_ = 0;
  hold_ = simulation_.q();
}

//------------------------------ a cycle passes ------------------------------

void MujocoRobot::pass(const JointVector& tau) noexcept {
  if (push_left_ > 0) simulation_.push((Wrench() << push_force_W_, 0, 0, 0).finished());
  simulation_.step(tau, finger_force());
  if (push_left_ > 0 && --push_left_ == 0) end_push();
  state_.tau_measured = tau;
  ++state_.cycle;
  measure();
  judge_contact();
  if (state_.mode != RobotMode::moving) return;
  if (const Fault fault = reflex(); fault != Fault::none) latch(fault);
}

// While a joint moves only damping acts on it; from rest on a spring holds it there.
void MujocoRobot::pass_braking() noexcept {
  for (int i = 0; i < 7; ++i) {
    if (std::abs(state_.dq[i]) > kBrakesHold) hold_[i] = state_.q[i];
  }
  const JointVector wanted =
      kBrakeStiffness.cwiseProduct(hold_ - state_.q) - kBrakeDamping.cwiseProduct(state_.dq);
  pass(wanted.cwiseMax(-kTorqueLimit).cwiseMin(kTorqueLimit));
}

void MujocoRobot::pass_finishing() noexcept {
  pass_braking();
  if (state_.mode != RobotMode::moving) return;
  resting_cycles_ = at_rest() ? resting_cycles_ + 1 : 0;
  if (resting_cycles_ >= kRestingCycles) {
    end_motion(RobotMode::idle);
  } else if (++finish_cycles_ >= kFinishTimeout) {
    latch(Fault::finish_timeout);
  }
}

void MujocoRobot::judge_contact() noexcept {
  filtered_torque_ += kFilter * (state_.tau_external - filtered_torque_);
  filtered_wrench_ += kFilter * (simulation_.contact_wrench() - filtered_wrench_);
  for (int i = 0; i < 7; ++i)
    state_.contact_joint[i] = beyond(filtered_torque_[i], options_.contact_torque[i]);
  for (int i = 0; i < 6; ++i)
    state_.contact_W[i] = beyond(filtered_wrench_[i], options_.contact_force[i]);
}

Fault MujocoRobot::reflex() const noexcept {
  if (outside_position_limits()) return Fault::joint_position_limit;
  if ((state_.dq.cwiseAbs().array() > kVelocityLimit.array()).any())
    return Fault::joint_velocity_limit;
  const Twist V_WE = simulation_.tool_velocity();
  if (V_WE.head<3>().norm() > kToolSpeed || V_WE.tail<3>().norm() > kToolTurn)
    return Fault::cartesian_velocity_limit;
  if ((filtered_torque_.cwiseAbs().array() > options_.collision_torque.array()).any() ||
      (filtered_wrench_.cwiseAbs().array() > options_.collision_force.array()).any())
    return Fault::collision;
  return Fault::none;
}

void MujocoRobot::count(bool received) noexcept {
  misses_ = received ? 0 : misses_ + 1;
  window_[window_next_] = received;
  window_next_ = (window_next_ + 1) % kWindow;
  window_size_ = std::min(window_size_ + 1, kWindow);
  state_.success_rate = static_cast<double>(window_.count()) / window_size_;
}

//------------------------------ measurement ------------------------------

void MujocoRobot::measure() noexcept {
  state_.q = simulation_.q();
  state_.dq = simulation_.dq();
  state_.tau_external = simulation_.external_torque();
  state_.gripper_width = simulation_.finger_position().sum();
}

void MujocoRobot::forget_contact() noexcept {
  filtered_torque_.setZero();
  filtered_wrench_.setZero();
  state_.contact_joint.fill(0);
  state_.contact_W.fill(0);
}

bool MujocoRobot::outside_position_limits() const noexcept {
  for (int i = 0; i < 7; ++i) {
    if (state_.q[i] < simulation_.lower_limit(i) || state_.q[i] > simulation_.upper_limit(i))
      return true;
  }
  return false;
}

bool MujocoRobot::at_rest() const noexcept { return state_.dq.cwiseAbs().maxCoeff() < kStandstill; }

//------------------------------ gripper ------------------------------

Eigen::Vector2d MujocoRobot::finger_force() noexcept {
  // What was heard `latency` cycles ago is followed now.
  const uint64_t ring = grip_delay_.size();
  const uint64_t latency = static_cast<uint64_t>(options_.gripper_latency_ms);
  grip_delay_[state_.cycle % ring] = grip_heard_;
  const double target = grip_delay_[(state_.cycle + ring - latency) % ring];
  const double travel = options_.gripper_speed * Simulation::kTimeStep;
  grip_reference_ += std::clamp(target - grip_reference_, -travel, travel);
  const Eigen::Vector2d p = simulation_.finger_position(), v = simulation_.finger_velocity();
  const double wanted =
      0.5 * (kFingerStiffness * (grip_reference_ - p.sum()) - kFingerDamping * v.sum());
  const double width = std::clamp(wanted, -options_.gripper_force, options_.gripper_force);
  const double centre =
      0.5 * (kCouplingStiffness * (p[1] - p[0]) + kCouplingDamping * (v[1] - v[0]));
  return {width + centre, width - centre};
}

}  // namespace tandem
