// What the link hears: every message passes the door, is judged, and is handed on or rejected and
// counted.

#include "controller/link/door.h"
#include "controller/link/link.h"

namespace tandem {
namespace {

constexpr int64_t kAnswerEveryUs = 50'000;  // requests for one episode; who asks more often waits

}  // namespace

void Link::hear_other(const lcm::ReceiveBuffer* buffer, const std::string&) {
  controller_status_t status{};
  if (!decode(buffer->data, buffer->data_size, status)) return;
  const bool ours = status.wall_instance == instance_;
  const bool starting = status.state == controller_status_t::WAITING && status.ticks == 0;
  const bool ended =
      status.state == controller_status_t::FINISHED || status.state == controller_status_t::FAULTED;
  if (!ours && !ended && (!starting || status.wall_instance < instance_)) other_controller_ = true;
}

void Link::hear_teleop(const lcm::ReceiveBuffer* buffer, const std::string&) {
  teleop_command_t message{};
  HumanCommand* slot = human_commands_.claim();
  const bool decoded = decode(buffer->data, buffer->data_size, message);
  const char* why = !slot      ? "too many came at once"
                    : !decoded ? "it does not decode"
                               : check_command(message, *slot);
  if (why) {
    ++board_.teleop_rejected;
    board_.rejected(std::string("TELEOP_COMMAND: ") + why + ".");
    return;
  }
  human_commands_.publish();
  ++board_.teleop_accepted;
  board_.last_teleop_us = monotonic_us();
  human_heard_.post();
}

void Link::hear_ack(const lcm::ReceiveBuffer* buffer, const std::string& channel) {
  episode_ack_t message{};
  if (!decode(buffer->data, buffer->data_size, message))
    return reject_learner(channel, "it does not decode");
  board_.last_learner_us = monotonic_us();
  const std::lock_guard lock(mutex_);
  pending_.erase(message.episode_acknowledged);
  board_.episodes_unacknowledged = static_cast<int64_t>(pending_.size());
}

void Link::hear_request(const lcm::ReceiveBuffer* buffer, const std::string& channel) {
  episode_request_t message{};
  if (!decode(buffer->data, buffer->data_size, message))
    return reject_learner(channel, "it does not decode");
  board_.last_learner_us = monotonic_us();
  std::shared_ptr<const FinishedEpisode> episode;
  {
    const std::lock_guard lock(mutex_);
    const auto found = pending_.find(message.episode_requested);
    const int64_t now_us = monotonic_us();
    if (found != pending_.end() && now_us >= found->second.answer_at_us) {
      found->second.answer_at_us = now_us + kAnswerEveryUs;
      episode = found->second.episode;
    }
  }
  if (episode) publish_episode(*episode, message.missing_steps);
}

void Link::hear_announce(const lcm::ReceiveBuffer* buffer, const std::string& channel) {
  policy_announce_t message{};
  if (!decode(buffer->data, buffer->data_size, message))
    return reject_learner(channel, "it does not decode");
  if (const std::string why = check_announcement(message); !why.empty())
    return reject_learner(channel, why);
  board_.last_learner_us = monotonic_us();
  if (announced_) announced_(message);
}

void Link::hear_learner(const lcm::ReceiveBuffer* buffer, const std::string& channel) {
  learner_status_t message{};
  if (!decode(buffer->data, buffer->data_size, message))
    return reject_learner(channel, "it does not decode");
  board_.last_learner_us = monotonic_us();
}

void Link::reject_learner(const std::string& channel, const std::string& why) {
  ++board_.learner_rejected;
  board_.rejected(channel + ": " + why + ".");
}

void Link::hear_command(const lcm::ReceiveBuffer* buffer, const std::string&) {
  controller_command_t message{};
  const bool decoded = decode(buffer->data, buffer->data_size, message);
  switch (decoded ? message.order : 0) {
    case controller_command_t::STOP:
      board_.stop = true;
      break;
    case controller_command_t::ESTOP:
      board_.estop = true;
      break;
    case controller_command_t::RECOVER:
      board_.recover = true;
      break;
    case controller_command_t::DISCARD:
      board_.discard = true;
      break;
    default:
      ++board_.commands_rejected;
      board_.rejected("CONTROLLER_COMMAND: it does not decode, or its order is unknown.");
  }
}

void Link::hear_gains(const lcm::ReceiveBuffer* buffer, const std::string&) {
  impedance_gains_t message{};
  ImpedanceGains gains;
  const bool decoded = decode(buffer->data, buffer->data_size, message);
  std::string why =
      decoded ? gains_from(message, latest_gains_, gains) : std::string("it does not decode");
  if (why.empty() && !gains_.push(gains)) why = "too many came at once";
  if (!why.empty()) {
    ++board_.gains_rejected;
    board_.rejected("IMPEDANCE_GAINS: " + why + ".");
    return;
  }
  latest_gains_ = gains;
  ++board_.gains_accepted;
}

}  // namespace tandem
