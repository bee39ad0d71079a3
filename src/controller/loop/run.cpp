#include "controller/loop/run.h"

#include <chrono>
#include <cstdio>
#include <thread>

namespace tandem {
namespace {

using std::chrono::milliseconds;

constexpr char kAwaitingRecovery[] = "an order to recover (./tandem command recover), for ";
constexpr int kInFlightMs = 200;      // longer than an order is under way
constexpr int kBrakingCycles = 2000;  // the arm stands long before
constexpr double kStanding = 0.005;   // rad/s

}  // namespace

// Present when bench/allocation_counter is preloaded: heap allocations of the calling thread.
extern "C" long tandem_allocations() __attribute__((weak));

Run::Run(const RunSettings& settings, const ControlSettings& control, Task& task,
         MujocoRobot& robot, ArmModel& model, ControlLoop& loop, PolicyWorker& worker, Link* link,
         PolicyLoader* loader, SpscRing<Record>& records, StatusBoard& board, RunPosition position)
    : settings_(settings),
      control_(control),
      task_(task),
      robot_(robot),
      model_(model),
      loop_(loop),
      worker_(worker),
      link_(link),
      loader_(loader),
      records_(records),
      board_(board),
      position_(std::move(position)),
      clock_(board) {
  board_.env_steps = position_.env_steps;
}

bool counts_allocations() { return tandem_allocations != nullptr; }

int Run::execute() {
  if (!settings_.lockstep) become_realtime(control_.realtime);
  try {
    while (!finished()) episode();
    robot_.stop();
    board_.state = controller_status_t::FINISHED;
    return 0;
  } catch (const Stopped&) {
    robot_.stop();
    board_.state = controller_status_t::FINISHED;
    return 130;
  } catch (const Failed& failed) {
    robot_.stop();
    board_.state = controller_status_t::FAULTED;
    board_.wait_for(failed.sentence);
    std::fprintf(stderr, "%s\n", failed.sentence.c_str());
    return 3;
  }
}

bool Run::finished() const {
  switch (settings_.mode) {
    case RunMode::train:
      return position_.demonstrations >= settings_.demonstrations &&
             position_.env_steps >= settings_.env_steps;
    case RunMode::bench:
      return position_.env_steps >= settings_.env_steps;
    default:
      return position_.next_episode >= settings_.episodes;
  }
}

void Run::episode() {
  while_waiting();
  EpisodeBegin begin;
  begin.episode = episode_ = position_.next_episode;
  const bool evaluation = settings_.mode == RunMode::evaluate || settings_.mode == RunMode::bench;
  const bool demonstration =
      settings_.mode == RunMode::demonstrate ||
      (settings_.mode == RunMode::train && position_.demonstrations < settings_.demonstrations);
  begin.phase = evaluation      ? Phase::evaluation
                : demonstration ? Phase::demonstration
                                : Phase::training;
  begin.has_policy = settings_.has_policy(begin.phase);
  begin.episode_seed = settings_.episode_seed(begin.episode);
  board_.episode = begin.episode;
  board_.phase = static_cast<int8_t>(begin.phase);
  tick_ = 0;
  if (begin.phase == Phase::training) wait_for_policy(begin.episode);
  begin.policy_version = policy_version_;

  board_.state = controller_status_t::RESETTING;
  task_.reset(robot_, model_, begin.episode_seed);
  robot_.seed_faults(begin.episode_seed);
  board_.discard = false;
  loop_.begin_episode(begin);
  Outcome outcome = run_steps();

  // The motion ends in good order, or has ended by a fault already.
  Fault fault = loop_.fault();
  if (fault == Fault::none) fault = finish_motion();
  if (!settings_.lockstep)
    await_answer(last_step_);  // not before: a moving robot can't wait for it
  if (fault != Fault::none) outcome = Outcome::fault;
  if (begin.phase == Phase::demonstration && settings_.mode == RunMode::train &&
      outcome != Outcome::success && outcome != Outcome::fault) {
    outcome = Outcome::discard;  // only good demonstrations are learnt from
  }
  faults_in_a_row_ = outcome == Outcome::fault ? faults_in_a_row_ + 1 : 0;
  board_.faults_in_a_row = faults_in_a_row_;
  if (fault != Fault::none) record_fault(begin.episode, fault);
  loop_.record(EpisodeFinish{utime(), outcome, fault});

  episode_end_t end;
  end.episode = begin.episode;
  end.phase = static_cast<int8_t>(begin.phase);
  end.outcome = static_cast<int8_t>(outcome);
  end.n_intervention_steps = intervened_ ? 1 : 0;
  const bool counts = begin.phase == Phase::training || settings_.mode == RunMode::bench;
  end.env_steps_total = position_.env_steps + (counts ? n_steps_ : 0);
  position_.add(end);
  board_.env_steps = position_.env_steps;
  board_.records_dropped = loop_.records_dropped();
  if (fault != Fault::none) halt(fault);
}

// A fault is latched: nothing moves until someone orders recovery, and that only so many times in a
// row.
void Run::halt(Fault fault) {
  clock_.restart();
  for (int cycle = 0; robot_.state().dq.norm() > kStanding && cycle < kBrakingCycles; ++cycle)
    pass_cycle();
  if (faults_in_a_row_ >= control_.faults_in_a_row) {
    throw Failed{std::to_string(faults_in_a_row_) +
                 " episodes in a row ended in a fault, the last one because " + fault_text(fault) +
                 "; the arm holds still. The limit is controller.faults_in_a_row."};
  }
  // An e-stop may have come while the arm was braking for something else.
  if (board_.estop.exchange(false) && fault != Fault::estop) {
    fault = Fault::estop;
    record_fault(-1, fault);
  }
  if (has_operator() || fault == Fault::estop) {
    board_.recover = false;
    board_.fault = static_cast<int32_t>(fault);
    board_.state = controller_status_t::HALTED;
    board_.wait_for(kAwaitingRecovery + std::string(fault_text(fault)));
    while (!board_.recover.exchange(false)) {
      stop_if_asked();
      forget_what_was_said();
      // An e-stop while something else is latched needs an order of its own.
      if (board_.estop.exchange(false)) {
        if (fault != Fault::estop) record_fault(-1, Fault::estop);
        fault = Fault::estop;
        board_.fault = static_cast<int32_t>(fault);
        board_.wait_for(kAwaitingRecovery + std::string(fault_text(fault)));
        std::this_thread::sleep_for(milliseconds(kInFlightMs));
        board_.recover = false;  // that order was on its way for the other fault
      }
      std::this_thread::sleep_for(milliseconds(5));
    }
    board_.fault = 0;
    board_.wait_for("");
  }
  clock_.restart();
  // A robot that still moves, or whose button is pressed, does not recover.
  for (int cycle = 0; !robot_.recover(); ++cycle) {
    if (cycle == kBrakingCycles) {
      throw Failed{std::string("the robot's fault can't be cleared: ") +
                   fault_text(robot_.state().fault) + "."};
    }
    pass_cycle();
  }
}

void Run::record_fault(int64_t episode, Fault fault) {
  loop_.record(FaultRecord{utime(), episode, episode < 0 ? 0 : tick_, fault, faults_in_a_row_,
                           control_.faults_in_a_row});
}

// A cycle in which the robot has itself in hand.
void Run::pass_cycle() {
  if (!settings_.lockstep) clock_.wait();
  robot_.miss();
}

Fault Run::finish_motion() {
  while (!robot_.finish()) {
    if (settings_.lockstep) continue;
    for (int missed = clock_.wait(); missed > 0; --missed) robot_.miss();
  }
  return robot_.state().fault;
}

Outcome Run::run_steps() {
  tick_ = 0;
  n_steps_ = 0;
  intervened_ = false;
  missed_cycles_ = 0;
  Outcome outcome = Outcome::timeout;
  for (int32_t step = 0; step < task_.spec().max_steps; ++step) {
    stop_if_asked();
    StepSnapshot snapshot = loop_.begin_step(task_.truth(robot_.simulation()), utime());
    if (step == 0 && !settings_.lockstep) {
      await_operator(snapshot);
      forget_what_was_said();
      clock_.restart();
    }
    board_.state = controller_status_t::RUNNING;
    start_step(snapshot, false);
    ticks_of_step();
    intervened_ |= loop_.end_step().intervention;
    ++n_steps_;
    publish_gauges();

    if (loop_.fault() != Fault::none) {
      outcome = Outcome::fault;
      break;
    }
    if (task_.succeeded(task_.truth(robot_.simulation()), robot_.simulation()) ||
        loop_.label() == teleop_command_t::LABEL_SUCCESS) {
      outcome = Outcome::success;
      break;
    }
    if (loop_.label() == teleop_command_t::LABEL_FAIL) {
      outcome = Outcome::failure;
      break;
    }
    if (loop_.label() == teleop_command_t::LABEL_DISCARD || board_.discard) {
      outcome = Outcome::discard;
      break;
    }
    relieve_recorder();
  }
  // The observation after the last step belongs to it as its next observation.
  StepSnapshot last = loop_.begin_step(task_.truth(robot_.simulation()), utime());
  last_step_ = last.step;
  start_step(last, true);
  return outcome;
}

void Run::ticks_of_step() {
  for (int i = 0; i < task_.spec().ticks_per_step && loop_.fault() == Fault::none; ++i) {
    int missed = 0;
    if (!settings_.lockstep) {
      // A late tick costs the robot a cycle, as on the real one.
      missed = clock_.wait();
      for (int n = 0; n < missed; ++n) robot_.miss();
    }
    tick(missed);
  }
  board_.ticks = loop_.ticks();
}

void Run::tick(int missed_cycles) {
  const int64_t start_ns = monotonic_ns();
  const int64_t allocations_before = tandem_allocations ? tandem_allocations() : 0;
  TickInput input{.utime = utime(), .missed_cycles = missed_cycles};
  if (!settings_.lockstep) {
    poll_partners(input.utime);
    if (link_) input.link_age_ms = 1e-3 * static_cast<double>(input.utime - board_.link_alive_us);
  }
  if (board_.estop) {
    loop_.stop(Fault::estop);
    return;
  }
  loop_.tick(input);
  ++tick_;
  if (tandem_allocations) board_.allocations += tandem_allocations() - allocations_before;
  board_.tick_time.add_ns(loop_.computed_ns() - start_ns);
  board_.robot_time.add_ns(monotonic_ns() - loop_.computed_ns());
}

void Run::publish_gauges() {
  const auto copy = [](const auto& from, auto& to) {
    for (size_t i = 0; i < to.size(); ++i)
      to[i] = static_cast<typename std::decay_t<decltype(to[i])>::value_type>(from[i]);
  };
  copy(loop_.grades(), board_.grades);
  const ChunkCounts& chunks = loop_.executor().counts();
  board_.chunks_taken = chunks.taken;
  board_.chunks_late = chunks.late;
  copy(chunks.refused, board_.chunks_refused);
  copy(loop_.safety().counts(), board_.limited_ticks);
  board_.policy_latency_ticks[0] = static_cast<int32_t>(loop_.executor().latency_ticks());
  board_.policy_latency_ticks[1] = static_cast<int32_t>(loop_.executor().largest_latency_ticks());
  board_.starved_ticks = loop_.starved_ticks();
  board_.records_dropped = loop_.records_dropped();
}

int64_t Run::utime() const {
  if (!settings_.lockstep) return monotonic_us();
  // Simulated time: every episode has a slot of its own, so that a resumed run has the stamps of
  // one that never stopped.
  const int64_t slot_ticks =
      static_cast<int64_t>(task_.spec().max_steps + 1) * task_.spec().ticks_per_step;
  return (episode_ * slot_ticks + tick_) * 1000;
}

void Run::stop_if_asked() const {
  if (board_.stop) throw Stopped{};
}

}  // namespace tandem
