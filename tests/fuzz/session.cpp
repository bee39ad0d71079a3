#include "fuzz/session.h"

#include "fuzz/targets.h"

namespace tandem::fuzz {

Session& Session::get() {
  static Session session;
  return session;
}

void Session::begin() {
  if (inputs_ < kInputs && rig_.loop.fault() == Fault::none) return;
  faults_ += rig_.loop.fault() != Fault::none;
  inputs_ = 0;
  rig_.begin(++episode_);
  rig_.loop.set_gains(rig_.control.gains, rig_.now_us);
  ticks_of_step_ = 0;
}

void Session::begin_step() {
  const StepSnapshot snapshot = rig_.begin_step();
  if (snapshot.chunk_id < 0) return;
  // The policy, too, pushes as hard as it may.
  const double push = episode_ % 2 ? 1.0 : -1.0;
  rig_.loop.accept(rig_.constant_chunk(snapshot.chunk_id, snapshot.step, Action::Constant(push)));
}

void Session::hear(const HumanCommand& command) {
  begin();
  rig_.loop.hear(command, rig_.now_us);
  run();
}

void Session::set_gains(const ImpedanceGains& gains) {
  begin();
  rig_.loop.set_gains(gains, rig_.now_us);
  run();
}

void Session::run() {
  ++inputs_;
  for (int i = 0; i < kTicks; ++i) {
    if (ticks_of_step_ == 0) begin_step();
    const JointVector before = rig_.loop.robot_state().tau_commanded;
    rig_.tick();
    rig_.drain();
    check(before);
    if (++ticks_of_step_ == rig_.task->spec().ticks_per_step) {
      rig_.loop.end_step();
      ticks_of_step_ = 0;
    }
  }
}

void Session::check(const JointVector& before) {
  ++ticks_;
  const RobotState& robot = rig_.loop.robot_state();
  const JointVector& tau = robot.tau_commanded;
  if (!tau.allFinite() || !robot.q.allFinite() || !robot.dq.allFinite()) {
    fail("torques and joint states are finite");
  }
  if ((tau.cwiseAbs().array() > SafetyFilter::torque_limit().array()).any()) {
    fail("no torque is above 87 N m (joints 1 to 4) or 12 N m (5 to 7)");
  }
  if (robot.fault == Fault::none && ((tau - before).cwiseAbs().array() > 1.0).any()) {
    fail("no torque changes by more than 1 N m in a tick");
  }
  switch (robot.fault) {
    case Fault::torque_discontinuity:
    case Fault::torque_range:
    case Fault::not_finite:
    case Fault::communication_constraints_violation:
      fail("the robot never has to refuse a torque");
    default:
      break;
  }
}

}  // namespace tandem::fuzz
