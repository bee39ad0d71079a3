#pragma once

#include <string>

#include "controller/loop/control_loop.h"
#include "controller/task/task.h"

namespace tandem::testing {

inline Section config(const std::string& file) {
  return Section::load(std::string(TANDEM_ROOT) + "/config/" + file);
}

/// The whole control side around a real simulated arm on the peg task, as main() wires it, without
/// other threads.
struct Rig {
  std::unique_ptr<Task> task = make_task(config("tasks/peg.yaml"));
  Simulation simulation{std::string(TANDEM_ROOT) + "/" + task->spec().scene};
  ArmModel model{std::string(TANDEM_ROOT) + "/models/panda/panda.urdf"};
  ControlSettings control = read_control(config("controller.yaml"));
  MujocoRobot robot{simulation, control.robot};
  SpscRing<Record> records{512};
  ControlLoop loop;

  explicit Rig(ExecutionSettings execution = {.mode = ExecutionMode::open_loop, .execute = 8})
      : loop(robot, model, task->spec(), control, execution, records) {
    task->attach(simulation);
    model.set_load(simulation.held_load());
  }

  void begin(uint64_t seed, Phase phase = Phase::training) {
    task->reset(robot, model, seed);
    robot.recover();
    loop.begin_episode({.episode = 0, .episode_seed = seed, .phase = phase}, false);
  }

  StepSnapshot begin_step() { return loop.begin_step(task->truth(simulation), 0); }

  /// One step of ticks; records are thrown away.
  StepRecord run_step() {
    for (int i = 0; i < task->spec().ticks_per_step; ++i) {
      loop.tick(0);
      drain();
    }
    const StepRecord step = loop.end_step();
    drain();
    return step;
  }

  void drain() {
    while (records.front()) records.pop();
  }

  static Chunk constant_chunk(int id, int start_step, const Action& action) {
    Chunk chunk;
    chunk.id = id;
    chunk.policy_version = 1;
    chunk.start_step = start_step;
    chunk.horizon = 8;
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
