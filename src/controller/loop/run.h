#pragma once

#include <string>

#include "controller/episode/recorder.h"
#include "controller/link/link.h"
#include "controller/link/policy_loader.h"
#include "controller/loop/clock.h"
#include "controller/loop/control_loop.h"
#include "controller/loop/policy_worker.h"
#include "controller/loop/run_settings.h"
#include "controller/loop/status_board.h"
#include "controller/robot/mujoco_robot.h"
#include "controller/task/task.h"

namespace tandem {

/// Whether heap allocations of the control thread are counted: bench/allocation_counter is
/// preloaded.
bool counts_allocations();

/// The control thread's programme: which episode comes next, under which policy, in which phase;
/// and within an episode, what is waited for (lockstep) or polled (real time) around the ticks.
class Run {
 public:
  /// @param link,loader null where the mode has no partner.
  Run(const RunSettings& settings, const ControlSettings& control, Task& task, MujocoRobot& robot,
      ArmModel& model, ControlLoop& loop, PolicyWorker& worker, Link* link, PolicyLoader* loader,
      SpscRing<Record>& records, StatusBoard& board, RunPosition position);

  /// Runs to the end. @returns the process's exit code: 0 finished, 3 fault (sentence on stderr),
  /// 130 stopped.
  int execute();

 private:
  struct Stopped {};  // thrown between episodes and waits when the run has to end
  struct Failed {
    std::string sentence;
  };

  bool finished() const;
  void episode();
  void wait_for_policy(int64_t episode);
  Outcome run_steps();
  void await_operator(const StepSnapshot& snapshot);
  void ticks_of_step();
  void tick(int missed_cycles);
  Fault finish_motion();
  /// episode: that it ended, -1 when none was running.
  void record_fault(int64_t episode, Fault fault);
  void halt(Fault fault);
  void pass_cycle();
  void publish_gauges();
  void start_step(StepSnapshot& snapshot, bool last);
  void await_answer(int32_t step);
  void await_human(const StepSnapshot& snapshot);
  void poll_partners(int64_t now_us);
  void forget_what_was_said();
  void take_answer(const PolicyAnswer& answer);
  /// In modes without an operator nobody is there to order a recovery; they run in simulation only.
  bool has_operator() const {
    return settings_.mode == RunMode::train || settings_.mode == RunMode::demonstrate;
  }
  int64_t utime() const;
  void stop_if_asked() const;
  void while_waiting();
  void relieve_recorder() const;

  RunSettings settings_;
  ControlSettings control_;
  Task& task_;
  MujocoRobot& robot_;
  ArmModel& model_;
  ControlLoop& loop_;
  PolicyWorker& worker_;
  Link* link_;
  PolicyLoader* loader_;
  SpscRing<Record>& records_;
  StatusBoard& board_;
  RunPosition position_;
  RealtimeClock clock_;

  int64_t episode_ = 0, tick_ = 0;
  int32_t policy_version_ = 0;
  bool intervened_ = false;
  int n_steps_ = 0;
  int32_t last_step_ = 0;
  int faults_in_a_row_ = 0;
  int missed_cycles_ = 0;
};

}  // namespace tandem
