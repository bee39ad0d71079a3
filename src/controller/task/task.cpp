#include "controller/task/task.h"

#include <algorithm>
#include <cmath>

#include "controller/task/peg.h"
#include "controller/task/square.h"
#include "controller/task/usb.h"

namespace tandem {

Task::Task(Section& section) {
  spec_.name = section.text("name");
  spec_.scene = section.text("scene");
  const double rate_hz = section.number("policy_rate_hz", 1.0, 200.0);
  spec_.ticks_per_step = static_cast<int>(std::lround(1000.0 / rate_hz));
  if (std::abs(spec_.ticks_per_step * rate_hz - 1000.0) > 1e-6) {
    throw ScenarioError(section.place("policy_rate_hz") +
                        " does not divide 1000 Hz; 10, 20, 25, 40, 50 and 100 do.");
  }
  spec_.max_steps = static_cast<int>(section.integer("max_steps", 1, 100000));

  spec_.action_axes = section.texts("action_axes");
  const std::vector<std::string> all = {"x", "y", "z", "rx", "ry", "rz", "gripper"};
  for (const std::string& name : spec_.action_axes) {
    const auto found = std::find(all.begin(), all.end(), name);
    if (found == all.end()) {
      throw ScenarioError(section.place("action_axes") + " names '" + name +
                          "'; axes are x y z rx ry rz gripper.");
    }
    spec_.axes[found - all.begin()] = 1.0;
  }
  const double translation = section.number("translation_limit_m", 0.0005, 0.1);
  const double rotation = section.number("rotation_limit_rad", 0.001, 0.5);
  for (int i = 0; i < 6; ++i)
    spec_.action_limit[i] = spec_.axes[i] * (i < 3 ? translation : rotation);

  const std::vector<double> low = section.numbers("workspace_low_m", 3, -1.0, 1.0);
  const std::vector<double> high = section.numbers("workspace_high_m", 3, -1.0, 1.0);
  for (int i = 0; i < 3; ++i) {
    if (!(low[i] < high[i])) {
      throw ScenarioError(section.place("workspace_low_m") +
                          " is not below workspace_high_m on every axis.");
    }
    spec_.workspace_low[i] = low[i];
    spec_.workspace_high[i] = high[i];
  }
}

std::unique_ptr<Task> make_task(Section section) {
  const std::string name = section.choice("name", {"peg", "square", "square-robosuite", "usb"});
  std::unique_ptr<Task> task;
  if (name == "peg") {
    task = std::make_unique<PegTask>(section);
  } else if (name == "usb") {
    task = std::make_unique<UsbTask>(section);
  } else {
    task = std::make_unique<SquareTask>(section);
  }
  section.leave("defaults");  // of the run and the method: applied when the scenario is composed
  section.finish();
  return task;
}

}  // namespace tandem
