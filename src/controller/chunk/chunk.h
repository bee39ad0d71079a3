#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstdint>

namespace tandem {

/// Longest chunk that the controller executes, policy steps.
inline constexpr int kMaxHorizon = 32;

/// Seven numbers in [-1, 1]: translation and rotation vector by which the commanded pose moves in
/// base axes, in units of the task's limit per step, then the gripper (-1 open, 1 closed).
using Action = Eigen::Matrix<double, 7, 1>;

/// h actions from one inference.
struct Chunk {
  int32_t id = -1;               ///< counts inferences in an episode
  int32_t policy_version = 0;    ///< 0 = no policy
  int64_t observation_tick = 0;  ///< control tick at which the observation was taken
  int32_t start_step = 0;        ///< policy step at which action 0 is due
  int32_t horizon = 0;           ///< h
  int32_t inference_us = 0;      ///< us, wall
  std::array<Action, kMaxHorizon> actions;
};

}  // namespace tandem
