#include "intervention/command_check.h"

#include <cmath>
#include <cstring>

namespace tandem {

const char* check_command(const teleop_command_t& message, HumanCommand& command) noexcept {
  // Written so that a NaN fails the comparison.
  for (const double value : message.device_twist) {
    if (!(std::abs(value) <= 1.0)) return "device_twist is not within [-1, 1]";
  }
  if (!(std::abs(message.device_gripper) <= 1.0)) return "device_gripper is not within [-1, 1]";
  if (message.engaged != 0 && message.engaged != 1) return "engaged is neither 0 nor 1";
  if (message.label < teleop_command_t::LABEL_NONE ||
      message.label > teleop_command_t::LABEL_DISCARD) {
    return "label is unknown";
  }
  if (message.operator_id.size() >= sizeof(command.operator_id))
    return "operator_id is longer than 31 characters";

  command.utime = message.utime;
  command.episode_answered = message.episode_answered;
  command.tick_answered = message.tick_answered;
  for (int i = 0; i < 6; ++i) command.twist[i] = message.device_twist[i];
  command.gripper = message.device_gripper;
  command.engaged = message.engaged == 1;
  command.label = message.label;
  std::memset(command.operator_id, 0, sizeof(command.operator_id));
  std::memcpy(command.operator_id, message.operator_id.data(), message.operator_id.size());
  return nullptr;
}

}  // namespace tandem
