#pragma once

#include <optional>
#include <string>
#include <tandem/control_tick_t.hpp>
#include <tandem/episode_end_t.hpp>
#include <tandem/episode_step_t.hpp>
#include <tandem/impedance_gains_t.hpp>
#include <tandem/robot_state_t.hpp>
#include <tandem/scenario_t.hpp>
#include <tandem/world_state_t.hpp>
#include <variant>
#include <vector>

#include "controller/chunk/chunk.h"
#include "controller/episode/log_files.h"
#include "intervention/command_check.h"

namespace tandem {

/// What was handed to the control side, and before which tick it took effect.
struct HandOff {
  int64_t tick = 0;
  std::variant<HumanCommand, Chunk, impedance_gains_t> what;
};

/// Everything that a log holds about one episode.
struct EpisodeEvents {
  std::vector<world_state_t> steps;   ///< starts of steps; the last one closes the episode
  std::vector<HandOff> hand_offs;     ///< by tick, in the order of taking effect
  std::vector<control_tick_t> ticks;  ///< real time only: every tick
  std::vector<robot_state_t> states;  ///< every few ticks
  std::vector<episode_step_t> results;
  episode_end_t end;
};

/// Reads a log of record episode by episode.
class LogReader {
 public:
  /// @throws std::runtime_error with a sentence when the file is no log of Tandem.
  explicit LogReader(const std::string& path);

  /// The log's first event.
  const scenario_t& scenario() const { return scenario_; }

  /// The next complete episode, or nothing at the end. @throws std::runtime_error with a sentence
  /// when an event does not decode.
  std::optional<EpisodeEvents> next(int ticks_per_step);

 private:
  std::string path_;
  EventReader events_;
  scenario_t scenario_;
};

}  // namespace tandem
