#pragma once

#include <string>

#include "controller/loop/control_loop.h"
#include "controller/task/task.h"

namespace tandem::testing {

inline Section config(const std::string& file) {
  return Section::load(std::string(TANDEM_ROOT) + "/config/" + file);
}

/// The whole control side around a real simulated arm at a task, as main() wires it, without other
/// threads. Its clock moves 1 ms a tick.
struct Rig {
  std::unique_ptr<Task> task;
  Simulation simulation{std::string(TANDEM_ROOT) + "/" + task->spec().scene};
  ArmModel model{std::string(TANDEM_ROOT) + "/models/panda/panda.urdf"};
  ControlSettings control = read_control(config("controller.yaml"));
  MujocoRobot robot{simulation, control.robot};
  SpscRing<Record> records{512};
  ControlLoop loop;
  int64_t now_us = 0;

  static constexpr int kHorizon = 8;

  explicit Rig(ExecutionSettings execution = {.mode = ExecutionMode::open_loop,
                                              .horizon = kHorizon,
                                              .execute = kHorizon},
               const std::string& task_name = "peg")
      : task(make_task(config("tasks/" + task_name + ".yaml"))),
        loop(robot, model, task->spec(), control, execution, records) {
    task->attach(simulation);
    model.set_load(simulation.held_load());
  }

  void begin(uint64_t seed, Phase phase = Phase::evaluation) {
    task->reset(robot, model, seed);
    robot.recover();
    loop.begin_episode({.episode = 0,
                        .episode_seed = seed,
                        .phase = phase,
                        .has_policy = phase != Phase::demonstration});
  }

  StepSnapshot begin_step() { return loop.begin_step(task->truth(simulation), now_us); }

  /// @returns the tick's record when there was room for it.
  void tick(double link_age_ms = 0.0) {
    loop.tick({.utime = now_us, .missed_cycles = 0, .link_age_ms = link_age_ms});
    now_us += 1000;
  }

  /// One step of ticks; records are thrown away.
  StepRecord run_step() {
    for (int i = 0; i < task->spec().ticks_per_step; ++i) {
      tick();
      drain();
    }
    const StepRecord step = loop.end_step();
    drain();
    return step;
  }

  void hear(const Twist& twist, bool engaged) { loop.hear(human(twist, engaged), now_us); }

  void drain() {
    while (records.front()) records.pop();
  }

  /// The record of the latest tick; everything else that waits is thrown away.
  TickRecord latest_tick() {
    TickRecord latest;
    while (const Record* record = records.front()) {
      if (const auto* tick = std::get_if<TickRecord>(record)) latest = *tick;
      records.pop();
    }
    return latest;
  }

  Chunk constant_chunk(int id, int start_step, const Action& action, int32_t version = 1) const {
    Chunk chunk;
    chunk.id = id;
    chunk.policy_version = version;
    chunk.start_step = start_step;
    chunk.observation_tick = static_cast<int64_t>(start_step) * task->spec().ticks_per_step;
    chunk.horizon = kHorizon;
    chunk.actions.fill(action);
    return chunk;
  }

  static HumanCommand human(const Twist& twist, bool engaged) {
    HumanCommand command;
    command.twist = twist;
    command.engaged = engaged;
    return command;
  }
};

}  // namespace tandem::testing
