#include "controller/loop/run_settings.h"

#include <tandem/world_state_t.hpp>

#include "base/random.h"

namespace tandem {
namespace {

constexpr size_t kRecentEpisodes = 20;

// Streams of episode seeds; evaluation never meets an episode of training, whatever the seeds.
constexpr uint64_t kTrainingStream = 1, kEvaluationStream = 2;

}  // namespace

RunSettings read_run(Section section) {
  RunSettings settings;
  const std::string mode = section.choice("mode", {"train", "evaluate", "demonstrate", "bench"});
  settings.mode = mode == "train"         ? RunMode::train
                  : mode == "evaluate"    ? RunMode::evaluate
                  : mode == "demonstrate" ? RunMode::demonstrate
                                          : RunMode::bench;
  settings.seed = static_cast<uint64_t>(section.integer("seed", 0, 1'000'000'000));
  settings.lockstep = section.choice("clock", {"lockstep", "realtime"}) == "lockstep";
  settings.sees = section.choice("observe", {"state", "image"}) == "image";
  settings.demonstrations = static_cast<int>(section.integer("demonstrations", 0, 10'000));
  settings.env_steps = section.integer("env_steps", 1, 1'000'000'000);
  settings.learner_lag = static_cast<int>(section.integer("learner_lag", 0, 100));
  settings.episodes = static_cast<int>(section.integer("episodes", 1, 1'000'000));
  settings.policy = section.text("policy");
  settings.robot_state_hz = static_cast<int>(section.integer("robot_state_hz", 0, 1000));
  // Logs of earlier versions, which replay reads, know neither.
  const auto bytes = [&section](const char* key) {
    return section.has(key) ? 1'000'000 * section.integer(key, 0, 100'000'000) : 0;
  };
  settings.log = {.file = bytes("log_file_mb"), .quota = bytes("log_quota_mb")};
  for (const char* key : {"task", "method", "evaluation_every", "evaluation_episodes",
                          "fresh_episodes", "video_episodes"})
    section.leave(key);
  if (settings.mode == RunMode::evaluate && settings.policy.empty()) {
    throw ScenarioError(section.place("policy") + " is empty; mode evaluate needs a policy file.");
  }
  section.finish();
  return settings;
}

uint64_t RunSettings::episode_seed(int64_t episode) const {
  const bool evaluation = mode == RunMode::evaluate || mode == RunMode::bench;
  const uint64_t stream = evaluation ? kEvaluationStream : kTrainingStream;
  return Random{seed, stream, static_cast<uint64_t>(episode)}.next() >> 1;
}

void RunPosition::add(const episode_end_t& end) {
  next_episode = end.episode + 1;
  env_steps = end.env_steps_total;
  const bool success = end.outcome == episode_end_t::SUCCESS;
  if (end.phase == world_state_t::DEMONSTRATION && success) {
    ++demonstrations;
    last_demonstration = end.episode;
  }
  if (end.phase == world_state_t::TRAINING) {
    helpless.push_back(success && end.n_intervention_steps == 0);
    if (helpless.size() > kRecentEpisodes) helpless.pop_front();
  }
}

double RunPosition::autonomous_success() const {
  if (helpless.empty()) return 0.0;
  int successes = 0;
  for (const bool success : helpless) successes += success ? 1 : 0;
  return static_cast<double>(successes) / static_cast<double>(helpless.size());
}

}  // namespace tandem
