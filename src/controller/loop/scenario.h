#pragma once

#include <memory>
#include <string>

#include "controller/chunk/chunk_executor.h"
#include "controller/loop/control_settings.h"
#include "controller/loop/run_settings.h"
#include "controller/task/task.h"

namespace tandem {

/// Everything that the scenario says to the controller.
struct Scenario {
  RunSettings run;
  ControlSettings control;
  ExecutionSettings execution;
  int horizon = 1;
  double discount = 1.0;
  std::unique_ptr<Task> task;
};

/// @throws ScenarioError naming line, key, value and range
Scenario read_scenario(Section root);

/// Robot and model of a scenario, as the robot is and as the law believes it to be.
struct Arm {
  Simulation simulation;
  ArmModel model;

  /// @param root of the checkout, where models/ lies. @throws std::runtime_error with a sentence,
  /// also when the two models do not agree.
  Arm(Task& task, const std::string& root);
};

}  // namespace tandem
