#pragma once

#include <functional>
#include <optional>
#include <string>

#include "controller/loop/control_loop.h"
#include "controller/loop/scenario.h"
#include "controller/replay/episode_events.h"
#include "controller/replay/recorded_robot.h"

namespace tandem {

/// Where the recomputed and the logged run part.
struct Difference {
  int64_t episode = 0, tick = 0;  ///< of a step's torques: the step's last tick
  std::string what;               ///< a clause with both values
};

struct ReplayResult {
  int64_t episodes = 0, steps = 0;
  int64_t without_motion = 0;  ///< of the episodes: nothing in the log to compute again
  int64_t ticks = 0;           ///< recomputed
  int64_t torques = 0;         ///< compared one by one, seven a tick
  int64_t differences = 0;     ///< ticks, steps and observations that are not equal to the bit
  std::optional<Difference> first;
};

/// Computes a logged run again, through the same code, and compares to the bit.
///
/// Lockstep: the whole control side with the simulated robot; the log gives seeds, human commands,
/// chunks and gains. Every torque is compared through the digest of its step, those of ROBOT_STATE
/// one by one, observations and executed actions as logged.
///
/// Real time: the control side; the log gives the robot's state of every tick (CONTROL_TICK) as
/// well, and every torque is compared one by one.
class Replay {
 public:
  /// @param root of the checkout, where models/ lies. @throws std::runtime_error, ScenarioError
  Replay(const std::string& log, const std::string& root);

  /// @param episodes at most so many, 0 = all. @param progress called after every episode.
  ReplayResult run(int64_t episodes, const std::function<void(const ReplayResult&)>& progress);

  bool lockstep() const { return scenario_.run.lockstep; }
  const std::string& git_revision() const { return log_.scenario().git_revision; }

 private:
  void episode(const EpisodeEvents& events);
  void hand_over(const HandOff& hand_off, int64_t utime);
  void compare_tick(const EpisodeEvents& events, int64_t tick);
  void compare_step(const EpisodeEvents& events, const StepRecord& step);
  void compare_observation(const EpisodeEvents& events, const StepSnapshot& snapshot);
  void differs(int64_t episode, int64_t tick, const std::string& what);
  void drain();

  LogReader log_;
  Scenario scenario_;
  Arm arm_;
  MujocoRobot simulated_;
  RecordedRobot recorded_;
  SpscRing<Record> records_;
  ControlLoop loop_;
  JointVector tau_ = JointVector::Zero();  // of the last tick
  size_t next_state_ = 0;
  ReplayResult result_;
};

}  // namespace tandem
