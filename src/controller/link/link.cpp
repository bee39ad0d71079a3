#include "controller/link/link.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <random>
#include <stdexcept>

#include "controller/episode/messages.h"
#include "controller/link/door.h"

namespace tandem {
namespace {

constexpr int64_t kStatusEveryUs = 100'000;
constexpr int64_t kResendEveryUs = 500'000;
constexpr int64_t kListenUs = 350'000;  // three status periods of another controller
// Bytes of a receiver's buffer: what a message takes beside twice its own, and what goes out at
// once.
constexpr size_t kMessageCost = 1024, kBurst = 72 * 1024;

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
  latest_gains_ = settings.gains;
  subscribe<&Link::hear_teleop>("TELEOP_COMMAND")->setQueueCapacity(256);
  subscribe<&Link::hear_command>("CONTROLLER_COMMAND")->setQueueCapacity(30);
  subscribe<&Link::hear_gains>("IMPEDANCE_GAINS")->setQueueCapacity(30);
  subscribe<&Link::hear_ack>("EPISODE_ACK")->setQueueCapacity(0);
  subscribe<&Link::hear_request>("EPISODE_REQUEST")->setQueueCapacity(0);
  subscribe<&Link::hear_announce>("POLICY_ANNOUNCE")->setQueueCapacity(0);
  subscribe<&Link::hear_learner>("LEARNER_STATUS")->setQueueCapacity(30);
}

// Raw: nothing is decoded before door.h has looked at it. By a plain function, because gcc's checks
// of undefined behaviour misread LCM's own call through a pointer to a member.
template <auto kHear>
lcm::Subscription* Link::subscribe(const char* channel) {
  return lcm_.subscribeFunction(
      channel,
      +[](const lcm::ReceiveBuffer* buffer, const std::string& name, Link* link) {
        (link->*kHear)(buffer, name);
      },
      this);
}

Link::~Link() {
  stop();
  close(wake_fd_);
}

void Link::refuse_second_controller() {
  // Listen for longer than another controller can be silent, telling of ourselves meanwhile: of two
  // that start together, the one with the larger number gives way.
  auto* subscription = subscribe<&Link::hear_other>("CONTROLLER_STATUS");
  const int64_t until_us = monotonic_us() + kListenUs;
  publish_status();
  while (!other_controller_ && monotonic_us() < until_us) lcm_.handleTimeout(20);
  lcm_.unsubscribe(subscription);
  if (other_controller_) {
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
  bool due;
  {
    const std::lock_guard lock(mutex_);
    due = robot_state_.offer(state, monotonic_us());
  }
  if (due) wake();
}

void Link::send(const action_chunk_t& chunk) {
  const std::lock_guard lock(mutex_);
  if (chunks_.size() < 64) chunks_.push_back(chunk);  // for watching only; the log has them all
}

void Link::send(std::shared_ptr<const CameraFrame> frame, const std::string& channel) {
  {
    const std::lock_guard lock(mutex_);
    if (frames_.size() == 16) frames_.erase(frames_.begin());
    frames_.emplace_back(channel, std::move(frame));
  }
  wake();
}

void Link::send(const policy_ack_t& ack) {
  {
    const std::lock_guard lock(mutex_);
    acks_.push_back(ack);
  }
  wake();
}

void Link::send(const controller_fault_t& fault) {
  {
    const std::lock_guard lock(mutex_);
    faults_.push_back(fault);
  }
  wake();
}

void Link::run() {
  pollfd fds[2] = {{lcm_.getFileno(), POLLIN, 0}, {wake_fd_, POLLIN, 0}};
  while (!stopping_) {
    poll(fds, 2, 20);
    board_.link_alive_us = monotonic_us();
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
    while (lcm_.handleTimeout(0) > 0) board_.link_alive_us = monotonic_us();
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
  std::vector<controller_fault_t> faults;
  decltype(frames_) frames;
  std::unique_ptr<robot_state_t> robot_state;
  std::vector<std::shared_ptr<const FinishedEpisode>> due;
  const int64_t now_us = monotonic_us();
  {
    const std::lock_guard lock(mutex_);
    chunks.swap(chunks_);
    acks.swap(acks_);
    frames.swap(frames_);
    faults.swap(faults_);
    robot_state = robot_state_.take(now_us);
    for (auto& [number, pending] : pending_) {
      if (now_us < pending.send_at_us) continue;
      pending.send_at_us = now_us + kResendEveryUs;
      due.push_back(pending.episode);
      if (due.size() == 8) break;
    }
  }
  if (robot_state) lcm_.publish("ROBOT_STATE", robot_state.get());
  for (const action_chunk_t& chunk : chunks) lcm_.publish("ACTION_CHUNK", &chunk);
  for (const auto& [channel, frame] : frames) {
    const camera_frame_t message = to_message(*frame);
    lcm_.publish(channel, &message);
  }
  for (const policy_ack_t& ack : acks) lcm_.publish("POLICY_ACK", &ack);
  for (const controller_fault_t& fault : faults) lcm_.publish("CONTROLLER_FAULT", &fault);
  for (const auto& episode : due) publish_episode(*episode, {});
}

void Link::publish_episode(const FinishedEpisode& episode, const std::vector<int32_t>& only_steps) {
  // Each step once, whatever was asked for.
  std::vector<bool> wanted(episode.steps.size(), only_steps.empty());
  for (const int32_t i : only_steps) {
    if (i >= 0 && static_cast<size_t>(i) < wanted.size()) wanted[static_cast<size_t>(i)] = true;
  }
  size_t burst = 0;
  for (size_t i = 0; i < wanted.size(); ++i) {
    if (!wanted[i]) continue;
    const std::vector<uint8_t>& bytes = episode.steps[i];
    lcm_.publish("EPISODE_STEP", bytes.data(), static_cast<unsigned>(bytes.size()));
    // Default socket buffers hold about 90 small messages, or 25 with an image: let the receiver
    // keep up.
    burst += kMessageCost + 2 * bytes.size();
    if (burst < kBurst) continue;
    burst = 0;
    usleep(500);
  }
  lcm_.publish("EPISODE_END", &episode.end);
}

controller_status_t Link::status() const {
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
  m.fault = board_.fault;
  m.faults_in_a_row = board_.faults_in_a_row;
  std::copy(board_.grades.begin(), board_.grades.end(), m.source_grade);
  m.wall_policy_age_ms = age_ms(board_.last_chunk_us);
  m.wall_teleop_age_ms = age_ms(board_.last_teleop_us);
  m.wall_learner_age_ms = age_ms(board_.last_learner_us);
  m.teleop_accepted = board_.teleop_accepted;
  m.teleop_rejected = board_.teleop_rejected;
  m.gains_accepted = board_.gains_accepted;
  m.gains_rejected = board_.gains_rejected;
  m.commands_rejected = board_.commands_rejected;
  m.learner_rejected = board_.learner_rejected;
  m.policies_rejected = board_.policies_rejected;
  m.chunks_taken = board_.chunks_taken;
  m.chunks_late = board_.chunks_late;
  std::copy(board_.chunks_refused.begin(), board_.chunks_refused.end(), m.chunks_refused);
  m.starved_ticks = board_.starved_ticks;
  std::copy(board_.policy_latency_ticks.begin(), board_.policy_latency_ticks.end(),
            m.policy_latency_ticks);
  std::copy(board_.limited_ticks.begin(), board_.limited_ticks.end(), m.limited_ticks);
  m.camera_frames = board_.camera_frames;
  m.camera_late = board_.camera_late;
  m.records_dropped = board_.records_dropped;
  m.log_bytes = board_.log_bytes;
  m.episodes_without_motion = board_.episodes_without_motion;
  m.episodes_unacknowledged = board_.episodes_unacknowledged;
  m.last_rejection = board_.last_rejection();
  m.waiting_for = board_.waiting_for();
  return m;
}

void Link::publish_status() {
  const controller_status_t m = status();
  lcm_.publish("CONTROLLER_STATUS", &m);
}

}  // namespace tandem
