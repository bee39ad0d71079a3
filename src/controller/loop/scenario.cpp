#include "controller/loop/scenario.h"

#include <filesystem>

#include "controller/robot/model_check.h"

namespace tandem {

Scenario read_scenario(Section root) {
  Scenario scenario;
  scenario.run = read_run(root.section("run"));
  scenario.control = read_control(root.section("controller"));
  Section method = root.section("method");
  scenario.horizon = static_cast<int>(method.integer("horizon", 1, kMaxHorizon));
  scenario.discount = method.number("discount", 0.0, 1.0);
  scenario.task = make_task(root.section("task"));
  if (scenario.run.sees) scenario.task->hide_truth();
  scenario.execution = read_execution(method.section("execution"), scenario.horizon,
                                      scenario.task->spec().ticks_per_step);
  method.text("name");
  method.leave("learner");
  method.finish();
  root.leave("operator");
  root.finish();
  // Real time has a latency of its own.
  if (!scenario.run.lockstep) scenario.execution.latency_ticks = 0;
  return scenario;
}

Arm::Arm(Task& task, const std::string& root)
    : simulation((std::filesystem::path(root) / task.spec().scene).string()),
      model((std::filesystem::path(root) / "models/panda/panda.urdf").string()) {
  task.attach(simulation);
  model.set_load(simulation.held_load());
  check_model(simulation, model);
}

}  // namespace tandem
