#pragma once

#include <cstdint>
#include <deque>
#include <string>
#include <tandem/episode_end_t.hpp>

#include "base/section.h"
#include "controller/episode/event_log.h"
#include "controller/task/scene.h"

namespace tandem {

enum class RunMode { train, evaluate, demonstrate, bench };

/// The `run` section of the scenario, as far as the controller needs it.
struct RunSettings {
  RunMode mode = RunMode::train;
  uint64_t seed = 0;
  bool lockstep = true;
  int demonstrations = 0;  ///< successful ones to collect before training
  int64_t env_steps = 0;   ///< training steps until the end
  bool sees = false;    ///< the policy looks through the camera, and is told nothing of the world
  int learner_lag = 1;  ///< episodes that the learner may be behind (lockstep)
  int episodes = 0;     ///< modes evaluate and demonstrate
  std::string policy;   ///< mode evaluate
  int robot_state_hz = 100;
  LogLimits log;

  /// Everything random in an episode comes from this; 63 bits, since it travels as a signed number.
  uint64_t episode_seed(int64_t episode) const;
  /// Whether a policy drives when the human does not.
  bool has_policy(Phase phase) const {
    return phase != Phase::demonstration && mode != RunMode::bench;
  }
};

/// @throws ScenarioError
RunSettings read_run(Section section);

/// What a run has behind it when it starts or continues.
struct RunPosition {
  int64_t next_episode = 0;
  int64_t env_steps = 0;
  int demonstrations = 0;           ///< successful
  int64_t last_demonstration = -1;  ///< number of the latest successful one
  std::deque<bool> helpless;        ///< latest training episodes: succeeded without help?

  void add(const episode_end_t& end);
  double autonomous_success() const;
};

}  // namespace tandem
