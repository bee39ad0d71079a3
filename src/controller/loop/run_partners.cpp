// The waiting and listening of a run: what the control thread takes from policy, operator and
// learner, and when.

#include <chrono>
#include <thread>

#include "controller/loop/run.h"

namespace tandem {
namespace {

using std::chrono::milliseconds;

constexpr int64_t kAskAgainUs = 50'000;  // WORLD_STATE is repeated after this
constexpr int64_t kOperatorDeadlineUs = 30'000'000;
constexpr int64_t kLearnerDeadlineUs = 120'000'000;  // of silence, not of training
constexpr int64_t kPolicyDeadlineUs = 10'000'000;
constexpr int64_t kOperatorAliveUs = 500'000;  // real time: heard so lately, he is there

}  // namespace

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
    board_.state = controller_status_t::WAITING;
    const std::string refused = loader_->refusal();
    board_.wait_for(refused.empty()
                        ? "the learner, to have trained on episode " + std::to_string(through)
                        : "a policy that can be used; the newest one was refused: " + refused);
    while_waiting();
    // In real time anyone may have announced it, and the learner's next one may be good.
    if (settings_.lockstep && !refused.empty())
      throw Failed{"the learner's policy was refused: " + refused};
    const int64_t heard_us = std::max(board_.last_learner_us.load(), start_us);
    if (monotonic_us() - heard_us > kLearnerDeadlineUs) {
      throw Failed{
          "the learner has been silent for 120 s; is it running? Its last words are in "
          "learner.out."};
    }
    if (!settings_.lockstep) std::this_thread::sleep_for(milliseconds(20));
  }
}

// A demonstration in real time begins when someone is there to give it.
void Run::await_operator(const StepSnapshot& snapshot) {
  if (snapshot.phase != Phase::demonstration || !link_) return;
  const auto there = [this] {
    const int64_t heard_us = board_.last_teleop_us;
    return heard_us >= 0 && monotonic_us() - heard_us < kOperatorAliveUs;
  };
  while (!there()) {
    board_.state = controller_status_t::WAITING;
    board_.wait_for(
        "an operator: './tandem teleop keyboard', or a program that sends "
        "TELEOP_COMMAND");
    while_waiting();
    link_->show_world(snapshot);
    std::this_thread::sleep_for(milliseconds(50));
  }
  board_.wait_for("");
}

void Run::start_step(StepSnapshot& snapshot, bool last) {
  snapshot.autonomous_success = position_.autonomous_success();
  if (last) snapshot.chunk_id = -1;
  if (!worker_.ask(snapshot) && settings_.lockstep)
    throw Failed{"the policy thread does not answer; this is a bug."};
  loop_.record(snapshot);
  if (link_ && !last) {
    while (const ImpedanceGains* gains = link_->gains().front()) {
      loop_.set_gains(*gains, utime());
      link_->gains().pop();
    }
  }
  if (link_ && has_operator() && !last) link_->show_world(snapshot);
  if (settings_.lockstep) await_answer(snapshot.step);
  if (settings_.lockstep && has_operator() && !last) await_human(snapshot);
}

void Run::take_answer(const PolicyAnswer& answer) {
  loop_.record(answer.observation);
  if (!answer.has_chunk) return;
  if (answer.chunk.policy_version != policy_version_) {
    policy_version_ = answer.chunk.policy_version;
    board_.policy_version = policy_version_;
    if (!settings_.lockstep) loop_.record(PolicyInForce{utime(), policy_version_});
  }
  loop_.accept(answer.chunk);
  board_.last_chunk_us.store(monotonic_us(), std::memory_order_relaxed);
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
        loop_.hear(*command, utime());
      } else {
        ++board_.teleop_rejected;  // an answer to an earlier tick, or to none
      }
      link_->human_commands().pop();
      if (this_tick) return;
    }
    link_->human_heard().wait_for(milliseconds(50));
    if (board_.estop) return;  // the next tick stops the arm
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

void Run::poll_partners(int64_t now_us) {
  while (const PolicyAnswer* answer = worker_.answer()) {
    take_answer(*answer);
    worker_.pop_answer();
  }
  if (!link_) return;
  while (const HumanCommand* command = link_->human_commands().front()) {
    loop_.hear(*command, now_us);
    link_->human_commands().pop();
  }
}

// Between episodes an e-stop halts as it does within one.
void Run::while_waiting() {
  stop_if_asked();
  forget_what_was_said();
  if (!board_.estop) return;
  record_fault(-1, Fault::estop);
  halt(Fault::estop);
}

// Real time: what a human said while nothing moved is not for the arm that moves next. In lockstep
// his answers name the tick that they are for.
void Run::forget_what_was_said() {
  if (!link_ || settings_.lockstep) return;
  while (link_->human_commands().front()) link_->human_commands().pop();
}

void Run::relieve_recorder() const {
  if (!settings_.lockstep) return;
  while (records_.size() > records_.capacity() / 2)
    std::this_thread::sleep_for(std::chrono::microseconds(100));
}

}  // namespace tandem
