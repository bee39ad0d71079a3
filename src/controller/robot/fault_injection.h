#pragma once

#include <cstdint>

#include "base/geometry.h"
#include "base/random.h"
#include "base/section.h"

namespace tandem {

/// What goes wrong with a simulated robot, and how often. A probability of 0 never happens, and
/// costs nothing.
struct Injection {
  double lost_commands = 0.0;  ///< share of the commands that never reach the robot, [0, 1]
  double burst = 0.0;          ///< probability per command that a burst of lost ones begins, [0, 1]
  int burst_longest = 25;      ///< commands; a burst's length is drawn from 1 to this, 1 to 1000
  double corruption = 0.0;     ///< probability per command that one joint's torque jumps, [0, 1]
  double corruption_jump = 5.0;  ///< N m, either sign, [0, 100]; above 2 it always trips the robot
  double push = 0.0;             ///< probability per cycle that somebody pushes the tool, [0, 1]
  double push_force = 30.0;      ///< N, in a random direction, [0, 200]
  int push_ms = 50;              ///< how long a push lasts, 1 to 10000
  double user_stop = 0.0;     ///< probability per cycle that somebody taps the stop button, [0, 1]
  double deaf_gripper = 0.0;  ///< probability per new target that the gripper misses it, [0, 1]
};

/// What has been injected since construction.
struct InjectionCounts {
  int64_t lost_commands = 0;  ///< by share and by burst
  int64_t corruptions = 0, pushes = 0, user_stops = 0, deaf_grips = 0;
};

/// The section `controller.robot.inject`. @throws ScenarioError
Injection read_injection(Section section);

/// Draws what goes wrong, cycle by cycle.
///
/// Every kind has a stream of its own, keyed by the episode's seed: an episode draws the same
/// faults whatever happened before it, and to switch one kind on leaves the others where they were.
/// Real-time after construction.
class FaultInjection {
 public:
  /// Seeded with 0 until the first seed(). @throws std::invalid_argument naming the value and its
  /// range.
  explicit FaultInjection(const Injection& injection);

  /// A new episode: all streams begin anew, a running burst ends.
  void seed(uint64_t episode_seed) noexcept;

  /// Is this command lost? Call once per command.
  bool loses_command() noexcept;
  /// Adds the jump to one joint when it is this command's turn. Call once per command.
  void corrupt(JointVector& tau) noexcept;
  /// Does a push begin in this cycle? Then `force_W` (N) is it, for push_ms().
  bool pushes(Eigen::Vector3d& force_W) noexcept;
  int push_ms() const noexcept { return injection_.push_ms; }
  /// Does somebody tap the stop button in this cycle?
  bool stops() noexcept;
  /// Does the gripper miss this new target?
  bool misses_grip() noexcept;

  const InjectionCounts& counts() const noexcept { return counts_; }

 private:
  Injection injection_;
  InjectionCounts counts_;
  Random lost_{}, burst_{}, corruption_{}, push_{}, stop_{}, grip_{};
  int burst_left_ = 0;  // commands
};

}  // namespace tandem
