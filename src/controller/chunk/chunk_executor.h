#pragma once

#include "base/section.h"
#include "controller/chunk/chunk.h"

namespace tandem {

enum class ExecutionMode { receding, open_loop };

/// How chunks are executed; the `method.execution` section.
struct ExecutionSettings {
  ExecutionMode mode = ExecutionMode::receding;
  int execute =
      1;  ///< open loop: steps of a chunk that are executed before the next inference, k <= h
  double noise_chunk =
      0.0;  ///< exploration: standard deviation of one offset for the whole chunk, action units
  double noise_step = 0.0;  ///< the same, drawn anew for every step
  double noise_clip = 0.0;  ///< bound on the sum of both
};

/// @throws ScenarioError
ExecutionSettings read_execution(Section section, int horizon);

/// Decides which action of which chunk is due at a policy step.
///
/// Before the first chunk, and when a chunk has run out, the action is "hold" (no motion, same
/// gripper). Exploration noise is added as a chunk is accepted: one offset for the chunk and one
/// per step, seeded by (episode seed, chunk id), never on masked axes or the gripper. Real-time: no
/// allocation, noexcept.
class ChunkExecutor {
 public:
  ChunkExecutor(const ExecutionSettings& settings, const Action& axes)
      : settings_(settings), axes_(axes) {}

  /// Forgets all chunks. @param explore whether noise is added in this episode.
  void begin_episode(uint64_t episode_seed, bool explore) noexcept;

  /// True when a new inference should be made from the observation of this step.
  bool needs_chunk(int32_t step) const noexcept;

  /// Takes a chunk over. A chunk that is older than the present one or malformed is refused and
  /// counted.
  /// @returns whether it was accepted.
  bool accept(const Chunk& chunk) noexcept;

  /// The present chunk is stale (a human moved the arm meanwhile): hold until the next one.
  void invalidate() noexcept;

  /// The action that is due at this step, in [-1, 1], masked axes 0. @param gripper what "same
  /// gripper" means now.
  Action action(int32_t step, double gripper) const noexcept;

  /// Which action of the present chunk is due, -1 when none.
  int32_t index(int32_t step) const noexcept;
  int32_t chunk_id() const noexcept { return valid_ ? chunk_.id : -1; }
  int32_t policy_version() const noexcept { return valid_ ? chunk_.policy_version : 0; }
  int64_t refused_count() const noexcept { return refused_count_; }

 private:
  ExecutionSettings settings_;
  Action axes_;  // 1 = active, 0 = masked
  Chunk chunk_;
  bool valid_ = false;
  bool explore_ = false;
  int32_t newest_id_ = -1;
  uint64_t episode_seed_ = 0;
  int64_t refused_count_ = 0;
};

}  // namespace tandem
