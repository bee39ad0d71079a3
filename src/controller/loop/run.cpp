#include "controller/loop/run.h"

#include <chrono>
#include <cstdio>
#include <thread>

#include "base/random.h"

namespace tandem {
namespace {

using std::chrono::milliseconds;

constexpr int kFaultsInARow = 5;
constexpr int64_t kAskAgainUs = 50'000;  // WORLD_STATE is repeated after this
constexpr int64_t kOperatorDeadlineUs = 30'000'000;
constexpr int64_t kLearnerDeadlineUs = 120'000'000;  // of silence, not of training
constexpr int64_t kPolicyDeadlineUs = 10'000'000;

// Streams of episode seeds; evaluation never meets an episode of training, whatever the seeds.
constexpr uint64_t kTrainingStream = 1, kEvaluationStream = 2;

}  // namespace

Run::Run(const RunSettings& settings, Task& task, MujocoRobot& robot, ArmModel& model,
         ControlLoop& loop, PolicyWorker& worker, Link* link, PolicyLoader* loader,
         SpscRing<Record>& records, StatusBoard& board, RunPosition position)
    : settings_(settings),
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

int Run::execute() {
  if (!settings_.lockstep) become_realtime(80);
  try {
    while (!finished()) episode();
    robot_.stop();
    board_.state = controller_status_t::FINISHED;
    return 0;
  } catch (const Stopped&) {
    robot_.stop();
    const bool emergency = board_.estop;
    board_.state = emergency ? controller_status_t::FAULTED : controller_status_t::FINISHED;
    if (emergency) std::fprintf(stderr, "stopped by an e-stop command; the arm holds still.\n");
    return emergency ? 3 : 130;
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
  stop_if_asked();
  EpisodeBegin begin;
  begin.episode = episode_ = position_.next_episode;
  const bool evaluation = settings_.mode == RunMode::evaluate || settings_.mode == RunMode::bench;
  const bool demonstration =
      settings_.mode == RunMode::demonstrate ||
      (settings_.mode == RunMode::train && position_.demonstrations < settings_.demonstrations);
  begin.phase = evaluation      ? Phase::evaluation
                : demonstration ? Phase::demonstration
                                : Phase::training;
  // 63 bits: it travels as a signed number.
  begin.episode_seed = Random{settings_.seed, evaluation ? kEvaluationStream : kTrainingStream,
                              static_cast<uint64_t>(begin.episode)}
                           .next() >>
                       1;
  board_.episode = begin.episode;
  board_.phase = static_cast<int8_t>(begin.phase);
  tick_ = 0;
  if (begin.phase == Phase::training) wait_for_policy(begin.episode);
  begin.policy_version = policy_version_;

  board_.state = controller_status_t::RESETTING;
  task_.reset(robot_, model_, begin.episode_seed);
  if (!robot_.recover()) throw Failed{"the robot's fault can't be cleared; see ROBOT_STATE.fault."};
  board_.state = controller_status_t::RUNNING;

  Outcome outcome = run_steps(begin);
  const Fault fault = robot_.state().fault;
  robot_.stop();
  if (begin.phase == Phase::demonstration && settings_.mode == RunMode::train &&
      outcome != Outcome::success && outcome != Outcome::fault) {
    outcome = Outcome::discard;  // only good demonstrations are learnt from
  }
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

  faults_in_a_row_ = outcome == Outcome::fault ? faults_in_a_row_ + 1 : 0;
  if (faults_in_a_row_ >= kFaultsInARow) {
    throw Failed{std::to_string(kFaultsInARow) +
                 " episodes in a row ended in a robot fault, the last one because " +
                 fault_text(fault) + "; the arm holds still."};
  }
}

void Run::wait_for_policy(int64_t episode) {
  board_.state = controller_status_t::WAITING;
  const int64_t through =
      std::max(episode - 1 - settings_.learner_lag, position_.last_demonstration);
  const int64_t start_us = monotonic_us();
  for (;;) {
    // In real time any policy will do: later ones come into force at a chunk boundary by
    // themselves.
    const int32_t version = settings_.lockstep ? loader_->put_in_force(through, milliseconds(20))
                                               : loader_->version_in_force();
    if (version != 0) {
      board_.wait_for("");
      if (settings_.lockstep) {
        policy_version_ = version;
        board_.policy_version = version;
        loop_.record(PolicyInForce{utime(), version});
      }
      return;
    }
    board_.wait_for("the learner, to have trained on episode " + std::to_string(through));
    stop_if_asked();
    if (!loader_->refusal().empty())
      throw Failed{"the learner's policy was refused: " + loader_->refusal()};
    const int64_t heard_us = std::max(board_.last_learner_us.load(), start_us);
    if (monotonic_us() - heard_us > kLearnerDeadlineUs) {
      throw Failed{
          "the learner has been silent for 120 s; is it running? Its last words are in "
          "learner.out."};
    }
    if (!settings_.lockstep) std::this_thread::sleep_for(milliseconds(20));
  }
}

Outcome Run::run_steps(const EpisodeBegin& begin) {
  const bool explore = begin.phase == Phase::training;
  loop_.begin_episode(begin, explore);
  tick_ = 0;
  n_steps_ = 0;
  intervened_ = false;
  Outcome outcome = Outcome::timeout;
  const int64_t not_finite_before = loop_.not_finite_count();
  clock_.restart();
  for (int32_t step = 0; step < task_.spec().max_steps; ++step) {
    StepSnapshot snapshot = loop_.begin_step(task_.truth(robot_.simulation()), utime());
    start_step(snapshot, false);
    ticks_of_step();
    intervened_ |= loop_.end_step().intervention;
    ++n_steps_;

    if (robot_.state().fault != Fault::none || loop_.not_finite_count() > not_finite_before) {
      outcome = Outcome::fault;
      break;
    }
    if (task_.succeeded(task_.truth(robot_.simulation()))) {
      outcome = Outcome::success;
      break;
    }
    const int8_t label = loop_.human().label;
    if (label == teleop_command_t::LABEL_DISCARD || label == teleop_command_t::LABEL_FAIL) {
      outcome = label == teleop_command_t::LABEL_FAIL ? Outcome::failure : Outcome::discard;
      break;
    }
    relieve_recorder();
  }
  // The observation after the last step belongs to it as its next observation.
  StepSnapshot last = loop_.begin_step(task_.truth(robot_.simulation()), utime());
  start_step(last, true);
  return outcome;
}

void Run::start_step(StepSnapshot& snapshot, bool last) {
  snapshot.autonomous_success = position_.autonomous_success();
  if (last) snapshot.chunk_id = -1;
  if (!worker_.ask(snapshot) && settings_.lockstep)
    throw Failed{"the policy thread does not answer; this is a bug."};
  loop_.record(snapshot);
  if (link_ && has_operator() && !last) link_->show_world(snapshot);
  if (settings_.lockstep || last) await_answer(snapshot.step);
  if (settings_.lockstep && has_operator() && !last) await_human(snapshot);
}

void Run::ticks_of_step() {
  for (int i = 0; i < task_.spec().ticks_per_step; ++i) {
    if (!settings_.lockstep) {
      // A late tick costs the robot a cycle, as on the real one.
      for (int missed = clock_.wait(); missed > 0; --missed) robot_.miss();
      poll_partners();
    }
    if (board_.estop) {
      robot_.stop();
      throw Stopped{};
    }
    const int64_t start_ns = monotonic_ns();
    loop_.tick(utime());
    board_.tick_time.add_ns(monotonic_ns() - start_ns);
    ++tick_;
  }
  board_.ticks = loop_.ticks();
  board_.records_dropped = loop_.records_dropped();
}

void Run::take_answer(const PolicyAnswer& answer) {
  loop_.record(answer.observation);
  if (!answer.has_chunk) return;
  if (answer.chunk.policy_version != policy_version_) {
    policy_version_ = answer.chunk.policy_version;
    board_.policy_version = policy_version_;
    if (!settings_.lockstep) loop_.record(PolicyInForce{utime(), policy_version_});
  }
  loop_.accept(answer.chunk, answer.observation_tick);
}

void Run::await_answer(int32_t step) {
  const int64_t start_us = monotonic_us();
  for (;;) {
    while (const PolicyAnswer* answer = worker_.answer()) {
      const bool this_step = answer->observation.step == step;
      take_answer(*answer);
      worker_.pop_answer();
      if (this_step) return;
    }
    worker_.answered().wait_for(milliseconds(100));
    if (monotonic_us() - start_us > kPolicyDeadlineUs) {
      throw Failed{"the policy thread has not answered step " + std::to_string(step) +
                   " for 10 s; this is a bug."};
    }
  }
}

void Run::await_human(const StepSnapshot& snapshot) {
  const int64_t start_us = monotonic_us();
  int64_t asked_us = start_us;
  for (;;) {
    while (const HumanCommand* command = link_->human_commands().front()) {
      const bool this_tick =
          command->episode_answered == snapshot.episode && command->tick_answered == snapshot.tick;
      if (this_tick) {
        loop_.hear(*command);
      } else {
        ++board_.teleop_rejected;  // an answer to an earlier tick, or to none
      }
      link_->human_commands().pop();
      if (this_tick) return;
    }
    link_->human_heard().wait_for(milliseconds(50));
    const int64_t now_us = monotonic_us();
    if (now_us - asked_us < kAskAgainUs) continue;
    stop_if_asked();
    asked_us = now_us;
    link_->show_world(snapshot);
    if (now_us - start_us > 1'000'000) board_.wait_for("the operator, to answer WORLD_STATE");
    if (now_us - start_us > kOperatorDeadlineUs) {
      throw Failed{
          "the operator has not answered WORLD_STATE for 30 s; is it running? Its last words are "
          "in operator.out."};
    }
  }
}

void Run::poll_partners() {
  while (const PolicyAnswer* answer = worker_.answer()) {
    take_answer(*answer);
    worker_.pop_answer();
  }
  if (!link_) return;
  while (const HumanCommand* command = link_->human_commands().front()) {
    loop_.hear(*command);
    link_->human_commands().pop();
  }
  const int64_t last_us = board_.last_teleop_us.load(std::memory_order_relaxed);
  if (last_us >= 0) loop_.human_silent((monotonic_us() - last_us) / 1000);
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

void Run::relieve_recorder() const {
  if (!settings_.lockstep) return;
  while (records_.size() > records_.capacity() / 2)
    std::this_thread::sleep_for(std::chrono::microseconds(100));
}

}  // namespace tandem
