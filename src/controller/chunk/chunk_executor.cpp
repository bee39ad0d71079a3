#include "controller/chunk/chunk_executor.h"

#include <algorithm>

#include "base/random.h"

namespace tandem {

ExecutionSettings read_execution(Section section, int horizon) {
  ExecutionSettings settings;
  const std::string mode = section.choice("mode", {"receding", "open_loop"});
  settings.mode = mode == "receding" ? ExecutionMode::receding : ExecutionMode::open_loop;
  settings.execute = static_cast<int>(section.integer("execute", 1, horizon));
  settings.noise_chunk = section.number("noise_chunk", 0.0, 1.0);
  settings.noise_step = section.number("noise_step", 0.0, 1.0);
  settings.noise_clip = section.number("noise_clip", 0.0, 1.0);
  section.finish();
  return settings;
}

void ChunkExecutor::begin_episode(uint64_t episode_seed, bool explore) noexcept {
  valid_ = false;
  newest_id_ = -1;
  explore_ = explore;
  episode_seed_ = episode_seed;
}

bool ChunkExecutor::needs_chunk(int32_t step) const noexcept {
  if (!valid_ || settings_.mode == ExecutionMode::receding) return true;
  return step - chunk_.start_step >= std::min(settings_.execute, chunk_.horizon);
}

bool ChunkExecutor::accept(const Chunk& chunk) noexcept {
  bool good = chunk.id > newest_id_ && chunk.horizon >= 1 && chunk.horizon <= kMaxHorizon;
  for (int i = 0; good && i < chunk.horizon; ++i) good = chunk.actions[i].allFinite();
  if (!good) {
    ++refused_count_;
    return false;
  }
  chunk_ = chunk;
  valid_ = true;
  newest_id_ = chunk.id;

  // Noise is drawn per axis so that a masked axis does not shift the numbers of the others.
  Random random = random_for(episode_seed_, Purpose::exploration, static_cast<uint64_t>(chunk.id));
  Action offset = Action::Zero();
  for (int axis = 0; axis < 6; ++axis) offset[axis] = random.normal(settings_.noise_chunk);
  for (int i = 0; i < chunk.horizon; ++i) {
    Action& action = chunk_.actions[i];
    for (int axis = 0; axis < 6; ++axis) {
      const double noise = offset[axis] + random.normal(settings_.noise_step);
      if (explore_) action[axis] += std::clamp(noise, -settings_.noise_clip, settings_.noise_clip);
    }
    action = action.cwiseMax(-1.0).cwiseMin(1.0).cwiseProduct(axes_).eval();
  }
  return true;
}

void ChunkExecutor::invalidate() noexcept { valid_ = false; }

int32_t ChunkExecutor::index(int32_t step) const noexcept {
  if (!valid_) return -1;
  const int32_t index = step - chunk_.start_step;
  return index >= 0 && index < chunk_.horizon ? index : -1;
}

Action ChunkExecutor::action(int32_t step, double gripper) const noexcept {
  const int32_t i = index(step);
  if (i >= 0) {
    Action action = chunk_.actions[i];
    if (axes_[6] == 0.0) action[6] = gripper;
    return action;
  }
  Action hold = Action::Zero();
  hold[6] = gripper;
  return hold;
}

}  // namespace tandem
