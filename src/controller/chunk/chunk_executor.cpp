#include "controller/chunk/chunk_executor.h"

#include <algorithm>
#include <cmath>

#include "base/random.h"

namespace tandem {
namespace {

/// Action of the chunk that is due at `step`, -1 when none. 64 bits: a step of a broken chunk may
/// be any number.
int32_t index_in(const Chunk& chunk, int64_t step) noexcept {
  const int64_t index = step - chunk.start_step;
  return index >= 0 && index < chunk.horizon ? static_cast<int32_t>(index) : -1;
}

}  // namespace

void ChunkExecutor::begin_episode(uint64_t episode_seed, bool explore) noexcept {
  explore_ = explore;
  episode_seed_ = episode_seed;
  Random random = random_for(episode_seed, Purpose::exploration_speed);
  speed_ = explore ? 1.0 + random.uniform(0.0, settings_.noise_speed) : 1.0;
  size_ = 0;
  taken_in_episode_ = 0;
  newest_id_ = -1;
  newest_version_ = 0;
  fresh_from_tick_ = 0;
}

bool ChunkExecutor::needs_chunk(int32_t step) const noexcept {
  if (size_ == 0 || settings_.mode != ExecutionMode::open_loop) return true;
  return static_cast<int64_t>(step) - newest().start_step >= settings_.execute;
}

Verdict ChunkExecutor::judge(const Chunk& chunk, int64_t tick) const noexcept {
  if (chunk.horizon != settings_.horizon || chunk.horizon < 1 || chunk.horizon > kMaxHorizon) {
    return Verdict::wrong_size;
  }
  for (int i = 0; i < chunk.horizon; ++i) {
    if (!chunk.actions[i].allFinite()) return Verdict::not_finite;
  }
  const auto end =
      taken_ids_.begin() + std::min<int64_t>(taken_in_episode_, static_cast<int64_t>(kTakenIds));
  if (std::find(taken_ids_.begin(), end, chunk.id) != end) return Verdict::duplicate;
  const int64_t start_tick = static_cast<int64_t>(chunk.start_step) * ticks_per_step_;
  if (chunk.id <= newest_id_ || chunk.observation_tick > tick || start_tick > tick) {
    return Verdict::out_of_order;
  }
  if (chunk.policy_version < newest_version_ || chunk.observation_tick < fresh_from_tick_) {
    return Verdict::stale;
  }
  if (index_in(chunk, tick / ticks_per_step_) < 0) return Verdict::expired;
  return tick > start_tick ? Verdict::taken_late : Verdict::taken;
}

Verdict ChunkExecutor::accept(const Chunk& chunk, int64_t tick) noexcept {
  const Verdict verdict = judge(chunk, tick);
  if (verdict != Verdict::taken && verdict != Verdict::taken_late) {
    ++counts_.refused[static_cast<int>(verdict) - static_cast<int>(Verdict::expired)];
    return verdict;
  }
  take(chunk);
  ++counts_.taken;
  counts_.late += verdict == Verdict::taken_late;
  latency_ticks_ = tick - chunk.observation_tick;
  largest_latency_ticks_ = std::max(largest_latency_ticks_, latency_ticks_);
  return verdict;
}

void ChunkExecutor::take(const Chunk& chunk) noexcept {
  newest_ = (newest_ + 1) % kMaxHorizon;
  size_ = std::min(size_ + 1, kMaxHorizon);
  chunks_[newest_] = chunk;
  add_noise(chunks_[newest_]);
  taken_ids_[taken_in_episode_++ % kTakenIds] = chunk.id;
  newest_id_ = chunk.id;
  newest_version_ = chunk.policy_version;
}

void ChunkExecutor::add_noise(Chunk& chunk) const noexcept {
  // Noise is drawn per axis so that a masked axis does not shift the numbers of the others.
  Random random = random_for(episode_seed_, Purpose::exploration, static_cast<uint64_t>(chunk.id));
  Action offset = Action::Zero();
  for (int axis = 0; axis < 6; ++axis) offset[axis] = random.normal(settings_.noise_chunk);
  for (int i = 0; i < chunk.horizon; ++i) {
    Action& action = chunk.actions[i];
    action.head<6>() *= speed_;
    for (int axis = 0; axis < 6; ++axis) {
      const double noise = offset[axis] + random.normal(settings_.noise_step);
      if (explore_) action[axis] += std::clamp(noise, -settings_.noise_clip, settings_.noise_clip);
    }
    action = action.cwiseMax(-1.0).cwiseMin(1.0).cwiseProduct(axes_).eval();
  }
}

void ChunkExecutor::invalidate(int64_t tick) noexcept {
  size_ = 0;
  fresh_from_tick_ = tick;
}

int32_t ChunkExecutor::index(int32_t step) const noexcept {
  return size_ > 0 ? index_in(newest(), step) : -1;
}

bool ChunkExecutor::due(int32_t step) const noexcept {
  const int candidates =
      settings_.mode == ExecutionMode::temporal_ensembling ? size_ : std::min(size_, 1);
  for (int age = 0; age < candidates; ++age) {
    if (index_in(back(age), step) >= 0) return true;
  }
  return false;
}

Action ChunkExecutor::action(int32_t step, double gripper) const noexcept {
  // The oldest prediction first: it weighs most in an ensemble, and is the only one otherwise.
  const bool ensemble = settings_.mode == ExecutionMode::temporal_ensembling;
  Action sum = Action::Zero();
  double weights = 0.0;
  int predictions = 0;
  for (int age = ensemble ? size_ - 1 : std::min(size_, 1) - 1; age >= 0; --age) {
    const int32_t i = index_in(back(age), step);
    if (i < 0) continue;
    const double weight = std::exp(-settings_.ensemble_decay * predictions++);
    sum += weight * back(age).actions[i];
    weights += weight;
  }
  if (predictions == 0) {
    Action hold = Action::Zero();
    hold[6] = gripper;
    return hold;
  }
  // Rounding of the mean must not carry an action over its limit.
  Action mean = (sum / weights).cwiseMax(-1.0).cwiseMin(1.0);
  if (axes_[6] == 0.0) mean[6] = gripper;
  return mean;
}

}  // namespace tandem
