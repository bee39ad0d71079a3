#include "controller/robot/fault_injection.h"

#include <cmath>
#include <sstream>
#include <stdexcept>

namespace tandem {
namespace {

constexpr int kLongestBurst = 1000;     // commands
constexpr double kLargestJump = 100.0;  // N m
constexpr double kLargestPush = 200.0;  // N
constexpr int kLongestPush = 10'000;    // ms
constexpr double kTwoPi = 6.283185307179586;

void require(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return;
  std::ostringstream sentence;
  sentence << "Injection " << name << " is " << value << "; it must be in [" << low << ", " << high
           << "].";
  throw std::invalid_argument(sentence.str());
}

bool chance(Random& random, double probability) {
  return probability > 0.0 && random.uniform(0.0, 1.0) < probability;
}

int below(Random& random, int count) {
  return static_cast<int>(random.next() % static_cast<uint64_t>(count));
}

}  // namespace

Injection read_injection(Section section) {
  Injection injection;
  injection.lost_commands = section.number("lost_commands", 0.0, 1.0);
  Section bursts = section.section("lost_bursts");
  injection.burst = bursts.number("probability", 0.0, 1.0);
  injection.burst_longest = static_cast<int>(bursts.integer("longest", 1, kLongestBurst));
  bursts.finish();
  Section corrupted = section.section("corrupted_commands");
  injection.corruption = corrupted.number("probability", 0.0, 1.0);
  injection.corruption_jump = corrupted.number("jump_Nm", 0.0, kLargestJump);
  corrupted.finish();
  Section pushes = section.section("pushes");
  injection.push = pushes.number("probability", 0.0, 1.0);
  injection.push_force = pushes.number("force_N", 0.0, kLargestPush);
  injection.push_ms = static_cast<int>(pushes.integer("duration_ms", 1, kLongestPush));
  pushes.finish();
  injection.user_stop = section.number("user_stop", 0.0, 1.0);
  injection.deaf_gripper = section.number("deaf_gripper", 0.0, 1.0);
  section.finish();
  return injection;
}

FaultInjection::FaultInjection(const Injection& injection) : injection_(injection) {
  require("lost_commands", injection.lost_commands, 0.0, 1.0);
  require("burst", injection.burst, 0.0, 1.0);
  require("burst_longest", injection.burst_longest, 1, kLongestBurst);
  require("corruption", injection.corruption, 0.0, 1.0);
  require("corruption_jump", injection.corruption_jump, 0.0, kLargestJump);
  require("push", injection.push, 0.0, 1.0);
  require("push_force", injection.push_force, 0.0, kLargestPush);
  require("push_ms", injection.push_ms, 1, kLongestPush);
  require("user_stop", injection.user_stop, 0.0, 1.0);
  require("deaf_gripper", injection.deaf_gripper, 0.0, 1.0);
  seed(0);
}

void FaultInjection::seed(uint64_t episode_seed) noexcept {
  Random* const streams[] = {&lost_, &burst_, &corruption_, &push_, &stop_, &grip_};
  uint64_t kind = 0;
  for (Random* stream : streams) *stream = random_for(episode_seed, Purpose::robot_faults, kind++);
  burst_left_ = 0;
}

bool FaultInjection::loses_command() noexcept {
  bool lost = chance(lost_, injection_.lost_commands);
  if (burst_left_ == 0 && chance(burst_, injection_.burst))
    burst_left_ = 1 + below(burst_, injection_.burst_longest);
  if (burst_left_ > 0) {
    --burst_left_;
    lost = true;
  }
  counts_.lost_commands += lost;
  return lost;
}

void FaultInjection::corrupt(JointVector& tau) noexcept {
  if (!chance(corruption_, injection_.corruption)) return;
  ++counts_.corruptions;
  const int joint = below(corruption_, 7);
  const double sign = below(corruption_, 2) == 0 ? -1.0 : 1.0;
  tau[joint] += sign * injection_.corruption_jump;
}

bool FaultInjection::pushes(Eigen::Vector3d& force_W) noexcept {
  if (!chance(push_, injection_.push)) return false;
  ++counts_.pushes;
  // Uniform over the sphere.
  const double up = push_.uniform(-1.0, 1.0), angle = push_.uniform(0.0, kTwoPi);
  const double level = std::sqrt(1.0 - up * up);
  force_W =
      injection_.push_force * Eigen::Vector3d(level * std::cos(angle), level * std::sin(angle), up);
  return true;
}

bool FaultInjection::stops() noexcept {
  const bool stop = chance(stop_, injection_.user_stop);
  counts_.user_stops += stop;
  return stop;
}

bool FaultInjection::misses_grip() noexcept {
  const bool missed = chance(grip_, injection_.deaf_gripper);
  counts_.deaf_grips += missed;
  return missed;
}

}  // namespace tandem
