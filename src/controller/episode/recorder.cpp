#include "controller/episode/recorder.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <tandem/episode_step_t.hpp>

#include "base/sha256.h"
#include "controller/episode/returns.h"

namespace tandem {
namespace {

constexpr size_t kFaultRecords = 50;  // as libfranka's ControlException carries

}  // namespace

Recorder::Recorder(SpscRing<Record>& ring, EventLog* log, const TaskSpec& task,
                   int observation_size, const RecorderSettings& settings, RecorderSinks sinks,
                   StatusBoard& board)
    : ring_(ring),
      log_(log),
      task_(task),
      observation_size_(observation_size),
      settings_(settings),
      sinks_(std::move(sinks)),
      board_(board),
      thread_([this] { run(); }) {}

Recorder::~Recorder() { stop(); }

void Recorder::stop() {
  stopping_ = true;
  if (thread_.joinable()) thread_.join();
}

void Recorder::run() {
  for (;;) {
    // Read the flag first: what was pushed before stop() is still drained.
    const bool stopping = stopping_;
    while (Record* record = ring_.front()) {
      std::visit([this](const auto& r) { take(r); }, *record);
      ring_.pop();
    }
    if (log_) {
      // However this process ends, the log holds what came before the latest batch.
      log_->flush();
      board_.log_bytes = log_->bytes();
      if (!log_->failure().empty()) board_.stop = true;
    }
    if (stopping) break;
    std::this_thread::sleep_for(std::chrono::microseconds(500));
  }
}

void Recorder::take(const EpisodeBegin& begin) {
  episode_ = begin;
  observations_.clear();
  images_.clear();
  steps_.clear();
  last_ticks_.clear();
  if (!log_) return;
  log_->begin_episode();
  keeps_motion_ = !log_->full();
  if (keeps_motion_) return;
  if (++board_.episodes_without_motion == 1) {
    std::fprintf(stderr,
                 "The log has %.0f MB, as many as run.log_quota_mb allows: from episode %lld on it "
                 "keeps what learning and resuming need, and no motion. The same command with a "
                 "larger --set run.log_quota_mb records it again.\n",
                 1e-6 * static_cast<double>(log_->bytes()), static_cast<long long>(begin.episode));
  }
}

void Recorder::take(const TickRecord& tick) {
  utime_ = tick.input.utime;
  if (last_ticks_.size() == kFaultRecords) last_ticks_.pop_front();
  last_ticks_.push_back(tick);
  if (settings_.every_tick) log_motion("CONTROL_TICK", to_control_tick(tick, episode_.episode));
  if (settings_.robot_state_every == 0 || tick.tick % settings_.robot_state_every != 0) return;
  const robot_state_t message = to_message(tick, episode_.episode);
  log_motion("ROBOT_STATE", message);
  if (sinks_.robot_state) sinks_.robot_state(message);
}

void Recorder::take(const ObservationRecord& observation) {
  const size_t index = static_cast<size_t>(observation.step);
  if (observations_.size() <= index) observations_.resize(index + 1);
  observations_[index].assign(observation.values.begin(),
                              observation.values.begin() + observation_size_);
  images_.resize(observations_.size());
  if (observation.image_step >= 0) images_[index] = frame_of(observation.image_step);
}

void Recorder::keep(std::shared_ptr<const CameraFrame> frame) {
  const std::lock_guard lock(mutex_);
  frames_.push_back(std::move(frame));
}

// In real time several observations may have to do with one frame, and some frames are never seen.
std::shared_ptr<const CameraFrame> Recorder::frame_of(int32_t step) {
  const std::lock_guard lock(mutex_);
  const auto is_past = [&](const CameraFrame& frame) {
    return frame.episode < episode_.episode ||
           (frame.episode == episode_.episode && frame.step < step);
  };
  while (!frames_.empty() && is_past(*frames_.front())) frames_.pop_front();
  return frames_.empty() ? nullptr : frames_.front();
}

void Recorder::take(const StepSnapshot& snapshot) {
  utime_ = snapshot.utime;
  log_motion("WORLD_STATE", to_message(snapshot, task_));
}

void Recorder::take(const ChunkRecord& chunk) {
  const action_chunk_t message = to_message(chunk, episode_.episode, utime_);
  log_motion("ACTION_CHUNK", message);
  if (sinks_.chunk) sinks_.chunk(message);
}

void Recorder::take(const HumanCommand& command) {
  log_motion("TELEOP_COMMAND", to_message(command));
}

void Recorder::take(const GainsRecord& gains) {
  log("IMPEDANCE_GAINS", gains.utime, to_message(gains.gains, gains.utime));
}

void Recorder::take(const StepRecord& step) { steps_.push_back(step); }

void Recorder::take(const PolicyInForce& policy) {
  if (!sinks_.announcement) return;
  policy_announce_t message = sinks_.announcement(policy.version);
  message.utime = policy.utime;
  log("POLICY_ANNOUNCE", policy.utime, message);
}

void Recorder::take(const EpisodeFinish& finish) {
  auto episode = std::make_shared<FinishedEpisode>(assemble(finish));
  if (log_) {
    for (const std::vector<uint8_t>& step : episode->steps)
      log_->write("EPISODE_STEP", finish.utime, step);
    if (settings_.every_tick && sinks_.status)
      log_->write("CONTROLLER_STATUS", finish.utime, sinks_.status());
    log_->write("EPISODE_END", finish.utime, episode->end);
    log_->flush();  // before anybody hears of it
  }
  episodes_.push_back(episode->end);
  if (sinks_.episode) sinks_.episode(std::move(episode));
}

void Recorder::take(const FaultRecord& fault) {
  controller_fault_t m;
  m.utime = fault.utime;
  m.episode = fault.episode;
  m.tick = fault.tick;
  m.fault = static_cast<int32_t>(fault.fault);
  m.sentence = fault_text(fault.fault);
  m.faults_in_a_row = fault.faults_in_a_row;
  m.faults_allowed = fault.faults_allowed;
  for (const TickRecord& tick : last_ticks_)
    m.last_records.push_back(to_message(tick, episode_.episode));
  m.n_records = static_cast<int32_t>(m.last_records.size());
  log("CONTROLLER_FAULT", fault.utime, m);
  if (sinks_.fault) sinks_.fault(m);
}

FinishedEpisode Recorder::assemble(const EpisodeFinish& finish) {
  // A step without its observations on both sides (an aborted one) is not a transition; nor is one
  // without its images, when there are any.
  const bool sees = std::any_of(images_.begin(), images_.end(), [](const auto& i) { return !!i; });
  size_t whole = 0;  // observations from the first on
  while (whole < observations_.size() && !observations_[whole].empty() && (!sees || images_[whole]))
    ++whole;
  const size_t n_steps = std::min(steps_.size(), whole > 0 ? whole - 1 : 0);

  std::vector<double> rewards(n_steps, 0.0);
  if (finish.outcome == Outcome::success && n_steps > 0) rewards.back() = 1.0;
  const std::vector<double> returns = discounted_returns(rewards, settings_.discount);

  FinishedEpisode episode;
  episode_end_t& end = episode.end;
  Sha256 digest;
  end.n_intervention_steps = end.n_takeovers = 0;
  end.force_peak = end.force_filtered_peak = 0.0;
  for (size_t t = 0; t < n_steps; ++t) {
    const StepRecord& step = steps_[t];
    episode_step_t m;
    m.utime = step.utime;
    m.episode = episode_.episode;
    m.step = step.step;
    m.n_observation = observation_size_;
    m.observation = observations_[t];
    m.next_observation = observations_[t + 1];
    for (int i = 0; i < 7; ++i) {
      m.policy_action[i] = static_cast<float>(step.policy[i]);
      m.human_action[i] = static_cast<float>(step.human[i]);
      m.executed_action[i] = static_cast<float>(step.executed[i]);
    }
    m.alpha = static_cast<float>(step.alpha_mean);
    m.intervention = step.intervention ? 1 : 0;
    const bool last = t + 1 == n_steps;
    m.terminated =
        last && (finish.outcome == Outcome::success || finish.outcome == Outcome::failure) ? 1 : 0;
    m.truncated = last && finish.outcome == Outcome::timeout ? 1 : 0;
    m.reward = static_cast<float>(rewards[t]);
    m.discounted_return = static_cast<float>(returns[t]);
    m.policy_version = step.policy_version;
    m.chunk_id = step.chunk_id;
    m.chunk_index = step.chunk_index;
    m.force_peak = static_cast<float>(step.force_peak);
    m.torque_digest = static_cast<int64_t>(step.torque_digest);
    if (images_[t]) m.image = images_[t]->jpeg;
    if (last && images_[t + 1]) m.next_image = images_[t + 1]->jpeg;
    m.n_image = static_cast<int32_t>(m.image.size());
    m.n_next_image = static_cast<int32_t>(m.next_image.size());
    episode.steps.push_back(encode(m));
    digest.add(episode.steps.back().data(), episode.steps.back().size());

    end.n_intervention_steps += step.intervention ? 1 : 0;
    end.n_takeovers += step.took_over ? 1 : 0;
    end.force_peak = std::max(end.force_peak, step.force_peak);
    end.force_filtered_peak = std::max(end.force_filtered_peak, step.force_filtered_peak);
  }

  if (episode_.phase == Phase::training) settings_.env_steps += static_cast<int64_t>(n_steps);
  end.utime = finish.utime;
  end.episode = episode_.episode;
  end.episode_seed = static_cast<int64_t>(episode_.episode_seed);
  end.phase = static_cast<int8_t>(episode_.phase);
  end.outcome = static_cast<int8_t>(finish.outcome);
  end.fault = static_cast<int32_t>(finish.fault);
  end.n_steps = static_cast<int32_t>(n_steps);
  end.undiscounted_return = n_steps > 0 ? rewards.back() : 0.0;
  end.env_steps_total = settings_.env_steps;
  end.policy_version = episode_.policy_version;
  end.steps_sha256 = digest.hex();
  return episode;
}

}  // namespace tandem
