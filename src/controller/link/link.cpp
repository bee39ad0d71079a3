#include "controller/link/link.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <random>
#include <stdexcept>

#include "controller/episode/messages.h"

namespace tandem {
namespace {

constexpr int64_t kStatusEveryUs = 100'000;
constexpr int64_t kRobotStateEveryUs = 10'000;
constexpr int64_t kResendEveryUs = 500'000;
constexpr int64_t kListenUs = 350'000;  // three status periods of another controller

}  // namespace

Link::Link(const Settings& settings, const TaskSpec& task, StatusBoard& board)
    : settings_(settings),
      task_(task),
      board_(board),
      lcm_(settings.url),
      instance_(static_cast<int64_t>((static_cast<uint64_t>(std::random_device{}()) << 31) ^
                                     std::random_device{}())),
      wake_fd_(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
  if (!lcm_.good()) {
    throw std::runtime_error(
        "LCM can't be started on '" + settings.url +
        "'; './tandem doctor' checks the network interface and the multicast route.");
  }
  refuse_second_controller();
  // Raw, so that bytes that do not even decode are counted as well.
  lcm_.subscribe("TELEOP_COMMAND", &Link::hear_teleop, this)->setQueueCapacity(256);
  auto subscribe = [this](const char* channel, auto handler, int capacity) {
    lcm_.subscribe(channel, handler, this)->setQueueCapacity(capacity);
  };
  subscribe("EPISODE_ACK", &Link::hear_ack, 0);
  subscribe("EPISODE_REQUEST", &Link::hear_request, 0);
  subscribe("POLICY_ANNOUNCE", &Link::hear_announce, 0);
  subscribe("LEARNER_STATUS", &Link::hear_learner, 30);
  subscribe("CONTROLLER_COMMAND", &Link::hear_command, 30);
}

Link::~Link() {
  stop();
  close(wake_fd_);
}

void Link::refuse_second_controller() {
  // Listen for longer than another controller can be silent, telling of ourselves meanwhile: of two
  // that start together, the one with the larger number gives way.
  bool other = false;
  auto* subscription = lcm_.subscribe<controller_status_t>(
      "CONTROLLER_STATUS", [this, &other](const lcm::ReceiveBuffer*, const std::string&,
                                          const controller_status_t* status) {
        const bool ours = status->wall_instance == instance_;
        const bool starting = status->state == controller_status_t::WAITING && status->ticks == 0;
        const bool ended = status->state == controller_status_t::FINISHED ||
                           status->state == controller_status_t::FAULTED;
        if (!ours && !ended && (!starting || status->wall_instance < instance_)) other = true;
      });
  const int64_t until_us = monotonic_us() + kListenUs;
  publish_status();
  while (!other && monotonic_us() < until_us) lcm_.handleTimeout(20);
  lcm_.unsubscribe(subscription);
  if (other) {
    throw std::runtime_error("another controller is at work on the LCM network '" +
                             (settings_.url.empty() ? std::string("default") : settings_.url) +
                             "'; stop it, or give this one a network of its own with --lcm-url "
                             "'udpm://239.255.76.67:PORT?ttl=0'.");
  }
}

void Link::start() {
  thread_ = std::thread([this] { run(); });
}

void Link::stop() {
  stopping_ = true;
  wake();
  if (thread_.joinable()) thread_.join();
}

void Link::wake() noexcept {
  const uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = ::write(wake_fd_, &one, sizeof(one));
}

bool Link::show_world(const StepSnapshot& snapshot) noexcept {
  const bool taken = world_.push(snapshot);
  wake();
  return taken;
}

void Link::send(std::shared_ptr<const FinishedEpisode> episode) {
  if (!settings_.learner) return;
  {
    const int64_t number = episode->end.episode;
    const std::lock_guard lock(mutex_);
    pending_[number] = {std::move(episode), 0};
    board_.episodes_unacknowledged = static_cast<int64_t>(pending_.size());
  }
  wake();
}

void Link::send(const robot_state_t& state) {
  const std::lock_guard lock(mutex_);
  robot_state_ = std::make_unique<robot_state_t>(state);
}

void Link::send(const action_chunk_t& chunk) {
  const std::lock_guard lock(mutex_);
  if (chunks_.size() < 64) chunks_.push_back(chunk);  // for watching only; the log has them all
}

void Link::send(const policy_ack_t& ack) {
  {
    const std::lock_guard lock(mutex_);
    acks_.push_back(ack);
  }
  wake();
}

void Link::run() {
  pollfd fds[2] = {{lcm_.getFileno(), POLLIN, 0}, {wake_fd_, POLLIN, 0}};
  while (!stopping_) {
    poll(fds, 2, 20);
    if (fds[1].revents & POLLIN) {
      uint64_t count;
      [[maybe_unused]] const ssize_t got = ::read(wake_fd_, &count, sizeof(count));
    }
    // The operator first: in lockstep the arm waits for him.
    while (StepSnapshot* snapshot = world_.front()) {
      const world_state_t message = to_message(*snapshot, task_);
      world_.pop();
      lcm_.publish("WORLD_STATE", &message);
    }
    while (lcm_.handleTimeout(0) > 0) {
    }
    publish_queued();
    if (monotonic_us() >= next_status_us_) {
      next_status_us_ = monotonic_us() + kStatusEveryUs;
      publish_status();
    }
  }
  publish_queued();
  publish_status();
}

void Link::publish_queued() {
  std::vector<action_chunk_t> chunks;
  std::vector<policy_ack_t> acks;
  std::unique_ptr<robot_state_t> robot_state;
  std::vector<std::shared_ptr<const FinishedEpisode>> due;
  const int64_t now_us = monotonic_us();
  {
    const std::lock_guard lock(mutex_);
    chunks.swap(chunks_);
    acks.swap(acks_);
    if (now_us >= next_robot_state_us_) robot_state.swap(robot_state_);
    for (auto& [number, pending] : pending_) {
      if (now_us < pending.send_at_us) continue;
      pending.send_at_us = now_us + kResendEveryUs;
      due.push_back(pending.episode);
      if (due.size() == 8) break;
    }
  }
  if (robot_state) {
    next_robot_state_us_ = now_us + kRobotStateEveryUs;
    lcm_.publish("ROBOT_STATE", robot_state.get());
  }
  for (const action_chunk_t& chunk : chunks) lcm_.publish("ACTION_CHUNK", &chunk);
  for (const policy_ack_t& ack : acks) lcm_.publish("POLICY_ACK", &ack);
  for (const auto& episode : due) publish_episode(*episode, {});
}

void Link::publish_episode(const FinishedEpisode& episode, const std::vector<int32_t>& only_steps) {
  const auto publish_step = [&](size_t i) {
    const std::vector<uint8_t>& bytes = episode.steps[i];
    lcm_.publish("EPISODE_STEP", bytes.data(), static_cast<unsigned>(bytes.size()));
    // Default socket buffers hold about 90 such messages: let the receiver keep up.
    if (i % 32 == 31) usleep(500);
  };
  if (only_steps.empty()) {
    for (size_t i = 0; i < episode.steps.size(); ++i) publish_step(i);
  } else {
    for (const int32_t i : only_steps) {
      if (i >= 0 && static_cast<size_t>(i) < episode.steps.size())
        publish_step(static_cast<size_t>(i));
    }
  }
  lcm_.publish("EPISODE_END", &episode.end);
}

void Link::publish_status() {
  const auto age_ms = [](int64_t last_us) {
    return last_us < 0 ? -1.0 : 1e-3 * static_cast<double>(monotonic_us() - last_us);
  };
  controller_status_t m;
  m.utime = monotonic_us();
  m.wall_instance = instance_;
  m.state = board_.state;
  m.phase = board_.phase;
  m.lockstep = settings_.lockstep ? 1 : 0;
  m.episode = board_.episode;
  m.env_steps_total = board_.env_steps;
  m.env_steps_budget = settings_.env_steps_budget;
  m.policy_version = board_.policy_version;
  m.ticks = board_.ticks;
  m.overruns = board_.overruns;
  const Histogram::Summary tick = board_.tick_time.summary(), wakeup = board_.wakeup.summary();
  std::copy(tick.begin(), tick.end(), m.wall_tick_us);
  std::copy(wakeup.begin(), wakeup.end(), m.wall_wakeup_us);
  m.wall_teleop_age_ms = age_ms(board_.last_teleop_us);
  m.wall_learner_age_ms = age_ms(board_.last_learner_us);
  m.teleop_accepted = board_.teleop_accepted;
  m.teleop_rejected = board_.teleop_rejected;
  m.policies_rejected = board_.policies_rejected;
  m.records_dropped = board_.records_dropped;
  m.episodes_unacknowledged = board_.episodes_unacknowledged;
  m.waiting_for = board_.waiting_for();
  lcm_.publish("CONTROLLER_STATUS", &m);
}

void Link::hear_teleop(const lcm::ReceiveBuffer* buffer, const std::string&) {
  teleop_command_t message;
  HumanCommand* slot = human_commands_.claim();
  const bool decoded = message.decode(buffer->data, 0, static_cast<int>(buffer->data_size)) >= 0;
  if (!slot || !decoded || check_command(message, *slot) != nullptr) {
    ++board_.teleop_rejected;
    return;
  }
  human_commands_.publish();
  ++board_.teleop_accepted;
  board_.last_teleop_us = monotonic_us();
  human_heard_.post();
}

void Link::hear_ack(const lcm::ReceiveBuffer*, const std::string&, const episode_ack_t* message) {
  board_.last_learner_us = monotonic_us();
  const std::lock_guard lock(mutex_);
  pending_.erase(message->episode_acknowledged);
  board_.episodes_unacknowledged = static_cast<int64_t>(pending_.size());
}

void Link::hear_request(const lcm::ReceiveBuffer*, const std::string&,
                        const episode_request_t* message) {
  board_.last_learner_us = monotonic_us();
  std::shared_ptr<const FinishedEpisode> episode;
  {
    const std::lock_guard lock(mutex_);
    const auto found = pending_.find(message->episode_requested);
    if (found != pending_.end()) episode = found->second.episode;
  }
  if (episode) publish_episode(*episode, message->missing_steps);
}

void Link::hear_announce(const lcm::ReceiveBuffer*, const std::string&,
                         const policy_announce_t* message) {
  board_.last_learner_us = monotonic_us();
  if (announced_) announced_(*message);
}

void Link::hear_learner(const lcm::ReceiveBuffer*, const std::string&, const learner_status_t*) {
  board_.last_learner_us = monotonic_us();
}

void Link::hear_command(const lcm::ReceiveBuffer*, const std::string&,
                        const controller_command_t* message) {
  if (message->order == controller_command_t::ESTOP) board_.estop = true;
  if (message->order == controller_command_t::STOP || message->order == controller_command_t::ESTOP)
    board_.stop = true;
}

}  // namespace tandem
