#include "controller/replay/replay.h"

#include <bit>
#include <cstdio>

namespace tandem {
namespace {

bool equal_bits(double a, double b) {
  return std::bit_cast<uint64_t>(a) == std::bit_cast<uint64_t>(b);
}

std::string both(const char* what, int index, double logged, double computed) {
  char text[160];
  std::snprintf(text, sizeof text, "%s %d is %.17g in the log and %.17g now", what, index, logged,
                computed);
  return text;
}

RobotState to_state(const control_tick_t& m) {
  RobotState state;
  state.q = JointVector::Map(m.q_measured);
  state.dq = JointVector::Map(m.dq_measured);
  state.tau_external = JointVector::Map(m.tau_external);
  state.tau_commanded = JointVector::Map(m.tau_received);
  state.gripper_width = m.gripper_width;
  state.mode = static_cast<RobotMode>(m.robot_mode);
  state.fault = static_cast<Fault>(m.fault);
  return state;
}

}  // namespace

Replay::Replay(const std::string& log, const std::string& root)
    : log_(log),
      scenario_(read_scenario(Section::parse(log_.scenario().scenario_yaml, log + " (SCENARIO)"))),
      arm_(*scenario_.task, root),
      simulated_(arm_.simulation, scenario_.control.robot),
      records_(1024),
      loop_(scenario_.run.lockstep ? static_cast<Robot&>(simulated_) : recorded_, arm_.model,
            scenario_.task->spec(), scenario_.control, scenario_.execution, records_) {}

ReplayResult Replay::run(int64_t episodes,
                         const std::function<void(const ReplayResult&)>& progress) {
  while (episodes == 0 || result_.episodes < episodes) {
    const std::optional<EpisodeEvents> events = log_.next(scenario_.task->spec().ticks_per_step);
    if (!events) break;
    if (events->steps.empty())
      ++result_.without_motion;
    else
      episode(*events);
    ++result_.episodes;
    progress(result_);
  }
  return result_;
}

void Replay::episode(const EpisodeEvents& events) {
  const bool lockstep = scenario_.run.lockstep;
  const world_state_t& start = events.steps.front();
  EpisodeBegin begin;
  begin.episode = start.episode;
  begin.episode_seed = static_cast<uint64_t>(start.episode_seed);
  begin.phase = static_cast<Phase>(start.phase);
  begin.has_policy = scenario_.run.has_policy(begin.phase);
  next_state_ = 0;

  // The arm where the episode found it.
  if (lockstep) {
    scenario_.task->reset(simulated_, arm_.model, begin.episode_seed);
    simulated_.recover();
    simulated_.seed_faults(begin.episode_seed);
  } else {
    // Stopped before its first tick: nothing moved, but gains may have come.
    if (!events.ticks.empty()) recorded_.show(to_state(events.ticks.front()));
  }
  loop_.begin_episode(begin);

  size_t hand_off = 0, step = 0;
  const int64_t n_ticks = events.steps.back().tick;
  for (int64_t tick = 0; tick < n_ticks; ++tick) {
    TickInput input;
    if (lockstep) {
      input.utime = start.utime + 1000 * tick;
    } else {
      if (static_cast<size_t>(tick) >= events.ticks.size()) {
        return differs(begin.episode, tick, "CONTROL_TICK is missing in the log from here on");
      }
      const control_tick_t& logged = events.ticks[static_cast<size_t>(tick)];
      recorded_.show(to_state(logged));
      input = {logged.utime, logged.missed_cycles, logged.link_age_ms};
    }
    if (tick == events.steps[step].tick) {
      if (step > 0) compare_step(events, loop_.end_step());
      const SceneTruth truth = scenario_.task->truth(arm_.simulation);
      const StepSnapshot snapshot = loop_.begin_step(truth, events.steps[step].utime);
      if (lockstep) compare_observation(events, snapshot);
      ++step;
    }
    for (; hand_off < events.hand_offs.size() && events.hand_offs[hand_off].tick <= tick;
         ++hand_off)
      hand_over(events.hand_offs[hand_off], input.utime);
    loop_.tick(input);
    ++result_.ticks;
    drain();
    compare_tick(events, tick);
  }
  for (; hand_off < events.hand_offs.size(); ++hand_off)
    hand_over(events.hand_offs[hand_off], start.utime + 1000 * n_ticks);
  if (n_ticks > 0) compare_step(events, loop_.end_step());
  drain();
}

void Replay::hand_over(const HandOff& hand_off, int64_t utime) {
  if (const auto* command = std::get_if<HumanCommand>(&hand_off.what)) {
    loop_.hear(*command, utime);
  } else if (const auto* chunk = std::get_if<Chunk>(&hand_off.what)) {
    loop_.accept(*chunk);
  } else {
    const auto& message = std::get<impedance_gains_t>(hand_off.what);
    ImpedanceGains gains;
    const std::string why = gains_from(message, scenario_.control.gains, gains);
    if (!why.empty()) return differs(result_.episodes, hand_off.tick, "logged gains: " + why);
    loop_.set_gains(gains, utime);
  }
}

void Replay::compare_tick(const EpisodeEvents& events, int64_t tick) {
  const double* logged = nullptr;
  if (!scenario_.run.lockstep) {
    logged = events.ticks[static_cast<size_t>(tick)].tau_commanded;
  } else {
    while (next_state_ < events.states.size() && events.states[next_state_].tick < tick)
      ++next_state_;
    if (next_state_ < events.states.size() && events.states[next_state_].tick == tick)
      logged = events.states[next_state_].tau_commanded;
  }
  if (!logged) return;
  result_.torques += 7;
  for (int i = 0; i < 7; ++i) {
    if (equal_bits(logged[i], tau_[i])) continue;
    return differs(events.end.episode, tick,
                   both("the torque of joint", i + 1, logged[i], tau_[i]));
  }
}

void Replay::compare_step(const EpisodeEvents& events, const StepRecord& step) {
  if (static_cast<size_t>(step.step) >= events.results.size()) return;  // cut short by a fault
  ++result_.steps;
  const episode_step_t& logged = events.results[static_cast<size_t>(step.step)];
  const int64_t tick = (step.step + 1) * scenario_.task->spec().ticks_per_step - 1;
  if (static_cast<uint64_t>(logged.torque_digest) != step.torque_digest)
    return differs(events.end.episode, tick, "the torques of this step have another digest");
  for (int i = 0; i < 7; ++i) {
    const float computed = static_cast<float>(step.executed[i]);
    if (logged.executed_action[i] == computed) continue;
    return differs(events.end.episode, tick,
                   both("executed action", i, logged.executed_action[i], computed));
  }
}

void Replay::compare_observation(const EpisodeEvents& events, const StepSnapshot& snapshot) {
  if (static_cast<size_t>(snapshot.step) >= events.results.size()) return;
  const std::vector<float>& logged = events.results[static_cast<size_t>(snapshot.step)].observation;
  std::array<float, kMaxObservation> computed{};
  scenario_.task->observation().write(snapshot, computed.data());
  for (size_t i = 0; i < logged.size() && i < computed.size(); ++i) {
    if (logged[i] == computed[i]) continue;
    return differs(events.end.episode, snapshot.tick,
                   both("observation", static_cast<int>(i), logged[i], computed[i]));
  }
}

void Replay::differs(int64_t episode, int64_t tick, const std::string& what) {
  ++result_.differences;
  if (!result_.first) result_.first = Difference{episode, tick, what};
}

void Replay::drain() {
  while (Record* record = records_.front()) {
    if (const auto* tick = std::get_if<TickRecord>(record)) tau_ = tick->tau_commanded;
    records_.pop();
  }
}

}  // namespace tandem
