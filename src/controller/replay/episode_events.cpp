#include "controller/replay/episode_events.h"

#include <algorithm>
#include <stdexcept>
#include <tandem/action_chunk_t.hpp>
#include <tandem/teleop_command_t.hpp>

namespace tandem {
namespace {

template <typename Message>
Message decode(const lcm::LogEvent& event, const std::string& path) {
  Message message;
  if (message.decode(event.data, 0, event.datalen) < 0) {
    throw std::runtime_error(path + ": event " + std::to_string(event.eventnum) + " on " +
                             event.channel +
                             " does not decode; the log was written by another version of Tandem "
                             "(its SCENARIO holds the git revision) or is damaged.");
  }
  return message;
}

Chunk to_chunk(const action_chunk_t& m, int ticks_per_step) {
  Chunk chunk;
  chunk.id = m.chunk_id;
  chunk.policy_version = m.policy_version;
  chunk.observation_tick = m.observation_tick;
  chunk.start_step = static_cast<int32_t>(m.start_tick / ticks_per_step);
  chunk.horizon = std::min(m.horizon, kMaxHorizon);
  for (int i = 0; i < chunk.horizon; ++i) {
    for (int axis = 0; axis < 7; ++axis) chunk.actions[i][axis] = m.policy_chunk[i][axis];
  }
  return chunk;
}

}  // namespace

LogReader::LogReader(const std::string& path) : path_(path), events_(path) {
  const lcm::LogEvent* first = events_.next();
  if (!first || first->channel != "SCENARIO") {
    throw std::runtime_error(path +
                             ": this is no log of a Tandem run; RUN/log.lcm begins with SCENARIO.");
  }
  scenario_ = decode<scenario_t>(*first, path);
}

std::optional<EpisodeEvents> LogReader::next(int ticks_per_step) {
  EpisodeEvents episode;
  int64_t next_tick = 0;  // in which something that stands here in the log took effect
  while (const lcm::LogEvent* event = events_.next()) {
    const std::string& channel = event->channel;
    if (channel == "WORLD_STATE") {
      episode.steps.push_back(decode<world_state_t>(*event, path_));
      next_tick = episode.steps.back().tick;
    } else if (channel == "CONTROL_TICK") {
      episode.ticks.push_back(decode<control_tick_t>(*event, path_));
      next_tick = episode.ticks.back().tick + 1;
    } else if (channel == "TELEOP_COMMAND") {
      HumanCommand command;
      if (!check_command(decode<teleop_command_t>(*event, path_), command))
        episode.hand_offs.push_back({next_tick, command});
    } else if (channel == "ACTION_CHUNK") {
      const action_chunk_t m = decode<action_chunk_t>(*event, path_);
      episode.hand_offs.push_back({m.taken_tick, to_chunk(m, ticks_per_step)});
    } else if (channel == "IMPEDANCE_GAINS") {
      episode.hand_offs.push_back({next_tick, decode<impedance_gains_t>(*event, path_)});
    } else if (channel == "ROBOT_STATE") {
      episode.states.push_back(decode<robot_state_t>(*event, path_));
    } else if (channel == "EPISODE_STEP") {
      episode.results.push_back(decode<episode_step_t>(*event, path_));
    } else if (channel == "EPISODE_END") {
      episode.end = decode<episode_end_t>(*event, path_);
      std::stable_sort(episode.hand_offs.begin(), episode.hand_offs.end(),
                       [](const HandOff& a, const HandOff& b) { return a.tick < b.tick; });
      return episode;
    }
  }
  return std::nullopt;
}

}  // namespace tandem
