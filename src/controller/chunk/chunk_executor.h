#pragma once

#include <array>
#include <cstdint>

#include "controller/chunk/chunk.h"
#include "controller/chunk/execution_settings.h"

namespace tandem {

/// What became of a chunk that was handed over.
enum class Verdict : int8_t {
  taken,         ///< takes over at its first step
  taken_late,    ///< takes over after its first step began, with the action that is really due
  expired,       ///< all its steps are past
  duplicate,     ///< its id was taken before
  out_of_order,  ///< older than the newest chunk taken, or from the future
  stale,         ///< from an older policy than the newest taken, or seen before the hand-back
  wrong_size,    ///< its horizon is not the method's
  not_finite     ///< an action is not a number
};

/// Chunks since construction, named as in controller_status_t.
struct ChunkCounts {
  int64_t taken = 0;                 ///< late ones included
  int64_t late = 0;                  ///< of these
  std::array<int64_t, 6> refused{};  ///< Verdict::expired ... Verdict::not_finite
};

/// Decides which action of which chunk is due at a policy step.
///
///   open_loop            the newest chunk; a new one is asked for after k steps of it
///   receding             the newest chunk; a new one is asked for at every step
///   temporal_ensembling  the mean of all chunks that have an action for the step, weighted by
///                        exp(-decay i), i = 0 the oldest (ACT); one is asked for at every step
///
/// A chunk is laid out in steps of the episode, so it takes over with the action of the step that
/// has really come, however long the inference took; until then the one before goes on. Before the
/// first chunk, and when chunks have run out, the action is "hold" (no motion, same gripper).
///
/// Exploration happens as a chunk is accepted: its motion goes faster by a factor that holds for
/// the episode, then noise is added, one offset for the chunk and one per step, seeded by (episode
/// seed, chunk id). Never on masked axes or the gripper.
///
/// Real-time: no allocation, no lock, noexcept. About 60 kB: chunks are kept in place.
class ChunkExecutor {
 public:
  /// @param axes 1 = active, 0 = masked. @param ticks_per_step >= 1.
  ChunkExecutor(const ExecutionSettings& settings, const Action& axes, int ticks_per_step)
      : settings_(settings), axes_(axes), ticks_per_step_(ticks_per_step) {}

  /// Forgets all chunks; the counts go on. @param explore whether this episode explores.
  void begin_episode(uint64_t episode_seed, bool explore) noexcept;

  /// True when a new inference should be made from the observation of this step.
  bool needs_chunk(int32_t step) const noexcept;

  /// Takes a chunk over at `tick` of the episode, or refuses it and leaves everything as it was.
  Verdict accept(const Chunk& chunk, int64_t tick) noexcept;

  /// The human hands back at `tick`: what was seen before it is stale. Holds until the next chunk.
  void invalidate(int64_t tick) noexcept;

  /// The action that is due at this step, in [-1, 1], masked axes 0. @param gripper what "same
  /// gripper" means now.
  Action action(int32_t step, double gripper) const noexcept;

  /// Which action of the newest chunk is due, -1 when none.
  int32_t index(int32_t step) const noexcept;
  /// Whether any chunk has an action for this step.
  bool due(int32_t step) const noexcept;

  /// Of the newest chunk: -1 and 0 when there is none.
  int32_t chunk_id() const noexcept { return size_ > 0 ? newest().id : -1; }
  int32_t policy_version() const noexcept { return size_ > 0 ? newest().policy_version : 0; }

  const ChunkCounts& counts() const noexcept { return counts_; }
  /// Ticks from observation to take-over: of the last chunk taken, and the largest since
  /// construction.
  int64_t latency_ticks() const noexcept { return latency_ticks_; }
  int64_t largest_latency_ticks() const noexcept { return largest_latency_ticks_; }

 private:
  static constexpr int kTakenIds = 64;

  Verdict judge(const Chunk& chunk, int64_t tick) const noexcept;
  void take(const Chunk& chunk) noexcept;
  void add_noise(Chunk& chunk) const noexcept;
  const Chunk& newest() const noexcept { return back(0); }
  const Chunk& back(int age) const noexcept {
    return chunks_[(newest_ + kMaxHorizon - age) % kMaxHorizon];
  }

  ExecutionSettings settings_;
  Action axes_;
  int ticks_per_step_;
  bool explore_ = false;
  uint64_t episode_seed_ = 0;
  double speed_ = 1.0;  // of this episode

  std::array<Chunk, kMaxHorizon> chunks_;  // a ring; a step is covered by at most h chunks
  int newest_ = 0, size_ = 0;

  std::array<int32_t, kTakenIds> taken_ids_{};  // a ring
  int64_t taken_in_episode_ = 0;
  int32_t newest_id_ = -1, newest_version_ = 0;
  int64_t fresh_from_tick_ = 0;

  ChunkCounts counts_;
  int64_t latency_ticks_ = 0, largest_latency_ticks_ = 0;
};

}  // namespace tandem
