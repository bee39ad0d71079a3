#include "controller/robot/mujoco_robot.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace tandem {
namespace {

constexpr int kMissesToFault = 20;
constexpr int kWindow = 100;
// Nominal: 1000 N m/s at 1 kHz. A limiter aims a little below (999.999 N m/s), so that rounding
// never trips the robot.
constexpr double kTorqueStep = 1000.0 * Simulation::kTimeStep;
constexpr double kFilter = 0.05;        // of a new value in the collision filter: 20 ms
constexpr double kWidest = 0.08;        // m, gripper
constexpr double kRestingSpeed = 0.02;  // rad/s, below which the brakes hold the position
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

void require(bool good, const char* name, double value, const char* range) {
  if (!good) {
    throw std::invalid_argument(std::string("Robot option ") + name + " is " +
                                std::to_string(value) + "; it must be " + range + ".");
  }
}

}  // namespace

MujocoRobot::MujocoRobot(Simulation& simulation, const MujocoRobotOptions& options)
    : simulation_(simulation), options_(options), random_(options.seed) {
  require(options.collision_torque.minCoeff() > 0, "collision_torque",
          options.collision_torque.minCoeff(), "above 0 N m");
  require(options.collision_force > 0, "collision_force", options.collision_force, "above 0 N");
  require(options.gripper_speed > 0 && options.gripper_speed <= 1, "gripper_speed",
          options.gripper_speed, "in (0, 1] m/s");
  require(options.gripper_force > 0 && options.gripper_force <= 140, "gripper_force",
          options.gripper_force, "in (0, 140] N");
  require(options.packet_loss >= 0 && options.packet_loss < 1, "packet_loss", options.packet_loss,
          "in [0, 1)");
  place(simulation.q(), simulation.finger_position().sum());
}

void MujocoRobot::write(const JointVector& tau) noexcept {
  if (state_.mode != RobotMode::idle && state_.mode != RobotMode::moving) return pass_braking();
  if (lost()) return miss();
  if (!tau.allFinite()) {
    latch(Fault::not_finite);
  } else if (((tau - state_.tau_commanded).cwiseAbs().array() > kTorqueStep).any()) {
    latch(Fault::torque_discontinuity);
  } else if ((tau.cwiseAbs().array() > kTorqueLimit.array()).any()) {
    latch(Fault::torque_range);
  }
  if (state_.fault != Fault::none) return pass_braking();
  state_.mode = RobotMode::moving;
  state_.tau_commanded = tau;
  count(true);
  pass(tau);
}

void MujocoRobot::miss() noexcept {
  if (state_.mode != RobotMode::moving) return pass_braking();
  count(false);
  if (misses_ >= kMissesToFault) {
    latch(Fault::communication_constraints_violation);
    return pass_braking();
  }
  pass(state_.tau_commanded);
}

void MujocoRobot::grip(double width) noexcept {
  if (std::isfinite(width)) grip_target_ = std::clamp(width, 0.0, kWidest);
}

void MujocoRobot::stop() noexcept {
  if (state_.mode == RobotMode::moving) end_motion(RobotMode::idle);
}

bool MujocoRobot::recover() noexcept {
  if (outside_position_limits()) return false;
  state_.fault = Fault::none;
  filtered_torque_.setZero();
  filtered_force_ = 0.0;
  if (state_.mode == RobotMode::reflex) state_.mode = RobotMode::idle;
  return true;
}

void MujocoRobot::place(const JointVector& q, double gripper_width) noexcept {
  simulation_.set_arm(q, gripper_width);
  grip_target_ = grip_reference_ = gripper_width;
  filtered_torque_.setZero();
  filtered_force_ = 0.0;
  state_.tau_measured.setZero();
  if (state_.mode == RobotMode::moving) end_motion(RobotMode::idle);
  hold_ = q;
  measure();
}

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
  hold_ = simulation_.q();
}

void MujocoRobot::pass(const JointVector& tau) noexcept {
  simulation_.step(tau, finger_force());
  state_.tau_measured = tau;
  ++state_.cycle;
  measure();
  filtered_torque_ += kFilter * (state_.tau_external - filtered_torque_);
  filtered_force_ += kFilter * (simulation_.contact_wrench().head<3>().norm() - filtered_force_);
  if (state_.mode != RobotMode::moving) return;
  if (outside_position_limits()) {
    latch(Fault::joint_position_limit);
  } else if ((state_.dq.cwiseAbs().array() > kVelocityLimit.array()).any()) {
    latch(Fault::joint_velocity_limit);
  } else if ((filtered_torque_.cwiseAbs().array() > options_.collision_torque.array()).any() ||
             filtered_force_ > options_.collision_force) {
    latch(Fault::collision);
  }
}

// While a joint moves only damping acts on it; from rest on a spring holds it there.
void MujocoRobot::pass_braking() noexcept {
  for (int i = 0; i < 7; ++i) {
    if (std::abs(state_.dq[i]) > kRestingSpeed) hold_[i] = state_.q[i];
  }
  const JointVector wanted =
      kBrakeStiffness.cwiseProduct(hold_ - state_.q) - kBrakeDamping.cwiseProduct(state_.dq);
  pass(wanted.cwiseMax(-kTorqueLimit).cwiseMin(kTorqueLimit));
}

void MujocoRobot::count(bool received) noexcept {
  misses_ = received ? 0 : misses_ + 1;
  window_[window_next_] = received;
  window_next_ = (window_next_ + 1) % kWindow;
  window_size_ = std::min(window_size_ + 1, kWindow);
  state_.success_rate = static_cast<double>(window_.count()) / window_size_;
}

void MujocoRobot::measure() noexcept {
  state_.q = simulation_.q();
  state_.dq = simulation_.dq();
  state_.tau_external = simulation_.external_torque();
  state_.gripper_width = simulation_.finger_position().sum();
}

bool MujocoRobot::lost() noexcept {
  if (options_.packet_loss <= 0) return false;
  random_ += 0x9E3779B97F4A7C15ull;  // splitmix64
  uint64_t z = random_;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1.0p-53 < options_.packet_loss;
}

bool MujocoRobot::outside_position_limits() const noexcept {
  for (int i = 0; i < 7; ++i) {
    if (state_.q[i] < simulation_.lower_limit(i) || state_.q[i] > simulation_.upper_limit(i))
      return true;
  }
  return false;
}

Eigen::Vector2d MujocoRobot::finger_force() noexcept {
  const double travel = options_.gripper_speed * Simulation::kTimeStep;
  grip_reference_ += std::clamp(grip_target_ - grip_reference_, -travel, travel);
  const Eigen::Vector2d p = simulation_.finger_position(), v = simulation_.finger_velocity();
  const double wanted =
      0.5 * (kFingerStiffness * (grip_reference_ - p.sum()) - kFingerDamping * v.sum());
  const double width = std::clamp(wanted, -options_.gripper_force, options_.gripper_force);
  const double centre =
      0.5 * (kCouplingStiffness * (p[1] - p[0]) + kCouplingDamping * (v[1] - v[0]));
  return {width + centre, width - centre};
}

}  // namespace tandem
