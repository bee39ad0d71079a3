#pragma once

#include "base/section.h"

namespace tandem {

enum class ExecutionMode { receding, open_loop, temporal_ensembling };

/// How chunks are executed; the `method.execution` section. Ranges and reasons:
/// config/methods/*.yaml.
struct ExecutionSettings {
  ExecutionMode mode = ExecutionMode::receding;
  int horizon = 1;  ///< h of every chunk, policy steps
  int execute = 1;  ///< open loop: steps of a chunk before the next inference, k <= h
  double ensemble_decay =
      0.0;                   ///< temporal ensembling: weight exp(-decay i), i = 0 the oldest chunk
  int latency_ticks = 0;     ///< lockstep: ticks from an observation to the take-over
  double noise_chunk = 0.0;  ///< exploration: standard deviation of one offset for the whole
                             ///< chunk, action units
  double noise_step = 0.0;   ///< the same, drawn anew for every step
  double noise_clip = 0.0;   ///< bound on the sum of both
  double noise_speed = 0.0;  ///< exploration: an episode's motions go faster by a draw between 0
                             ///< and this share
};

/// @param horizon h of the method. @param ticks_per_step of the task: the modelled latency stays
/// within a step, so that at most one inference is under way. @throws ScenarioError
ExecutionSettings read_execution(Section section, int horizon, int ticks_per_step);

}  // namespace tandem
