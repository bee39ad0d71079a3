#pragma once

#include <tandem/action_chunk_t.hpp>
#include <tandem/camera_frame_t.hpp>
#include <tandem/control_tick_t.hpp>
#include <tandem/episode_end_t.hpp>
#include <tandem/robot_state_t.hpp>
#include <tandem/teleop_command_t.hpp>
#include <tandem/world_state_t.hpp>
#include <vector>

#include "controller/camera/camera_frame.h"
#include "controller/episode/record.h"
#include "controller/task/task.h"

/// Records of the control thread as messages of the wire; the one place that knows both.
namespace tandem {

robot_state_t to_message(const TickRecord& record, int64_t episode);
control_tick_t to_control_tick(const TickRecord& record, int64_t episode);
world_state_t to_message(const StepSnapshot& snapshot, const TaskSpec& task);
action_chunk_t to_message(const ChunkRecord& record, int64_t episode, int64_t utime);
teleop_command_t to_message(const HumanCommand& command);
camera_frame_t to_message(const CameraFrame& frame);

/// Encoded bytes of a message.
template <typename Message>
std::vector<uint8_t> encode(const Message& message) {
  std::vector<uint8_t> bytes(message.getEncodedSize());
  message.encode(bytes.data(), 0, static_cast<int>(bytes.size()));
  return bytes;
}

}  // namespace tandem
