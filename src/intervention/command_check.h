#pragma once

#include <tandem/teleop_command_t.hpp>

#include "base/geometry.h"

namespace tandem {

/// A TELEOP_COMMAND that passed the door. Fixed size, so that it can cross threads without
/// allocation.
struct HumanCommand {
  int64_t utime = 0;  ///< us, as sent
  int64_t episode_answered = -1;
  int64_t tick_answered = -1;
  Twist twist = Twist::Zero();  ///< [-1, 1], base axes
  double gripper = 0.0;         ///< [-1, 1]
  bool engaged = false;
  int8_t label = 0;  ///< teleop_command_t::LABEL_*
  char operator_id[32] = {};
};

/// Checks a message from the network: finite, in range, known label. @returns null when it is good
/// and `command` is filled, else a clause that says what is wrong; never throws.
const char* check_command(const teleop_command_t& message, HumanCommand& command) noexcept;

}  // namespace tandem
