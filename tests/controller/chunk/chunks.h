#pragma once

#include "controller/chunk/chunk_executor.h"

namespace tandem::testing {

inline constexpr int kTicksPerStep = 100;

/// Observed at the start of its first step; action i is `first` + 0.1 i on every axis.
inline Chunk chunk(int id, int start_step, int horizon, double first = 0.1) {
  Chunk c;
  c.id = id;
  c.policy_version = 7;
  c.observation_tick = static_cast<int64_t>(start_step) * kTicksPerStep;
  c.start_step = start_step;
  c.horizon = horizon;
  for (int i = 0; i < horizon; ++i) c.actions[i] = Action::Constant(first + 0.1 * i);
  return c;
}

inline ChunkExecutor executor(ExecutionMode mode, int horizon, int execute = 1,
                              const Action& axes = Action::Ones()) {
  ExecutionSettings settings;
  settings.mode = mode;
  settings.horizon = horizon;
  settings.execute = execute;
  settings.ensemble_decay = 0.01;
  settings.noise_chunk = 0.1;
  settings.noise_step = 0.05;
  settings.noise_clip = 0.2;
  ChunkExecutor e(settings, axes, kTicksPerStep);
  e.begin_episode(1, false);
  return e;
}

}  // namespace tandem::testing
