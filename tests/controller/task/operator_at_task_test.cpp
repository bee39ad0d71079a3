#include <gtest/gtest.h>

#include <optional>

#include "controller/episode/messages.h"
#include "controller/rig.h"
#include "intervention/scripted_operator.h"

namespace tandem {
namespace {

using testing::Rig;

/// The scripted operator demonstrates a task on the real control side, without the wire between.
struct OperatorAtTask : Rig {
  explicit OperatorAtTask(const std::string& name)
      : Rig({.mode = ExecutionMode::open_loop, .horizon = kHorizon, .execute = kHorizon}, name) {}

  ScriptedOperator person{read_rules(testing::config("operator.yaml"))};

  /// @param accident may happen before any step. @returns steps to success, or nothing.
  template <typename Accident>
  std::optional<int> demonstrate(uint64_t seed, Accident accident) {
    begin(seed, Phase::demonstration);
    drain();
    for (int step = 0; step < task->spec().max_steps; ++step) {
      accident(step);
      const teleop_command_t command = person.answer(to_message(begin_step(), task->spec()));
      HumanCommand heard = human(Twist::Map(command.device_twist), command.engaged);
      heard.gripper = command.device_gripper;
      loop.hear(heard, now_us);
      run_step();
      if (loop.fault() != Fault::none) return std::nullopt;
      if (task->succeeded(task->truth(simulation), simulation)) return step + 1;
    }
    return std::nullopt;
  }
};

constexpr auto kNothing = [](int) {};

class EveryTask : public ::testing::TestWithParam<std::string> {};

TEST_P(EveryTask, IsSolvedByTheOperator) {
  OperatorAtTask at(GetParam());
  for (uint64_t seed : {1, 2, 3}) EXPECT_TRUE(at.demonstrate(seed, kNothing)) << "seed " << seed;
}

INSTANTIATE_TEST_SUITE_P(Tasks, EveryTask,
                         ::testing::Values("peg", "square", "square-robosuite", "usb"));

TEST(ScriptedOperatorAtSquare, TakesAgainWhatTheHandHasDropped) {
  OperatorAtTask at("square");
  const int undisturbed = at.demonstrate(5, kNothing).value_or(0);
  ASSERT_GT(undisturbed, 40);
  const int dropped_at = undisturbed / 2;
  const auto drop = [&](int step) {
    if (step != dropped_at) return;
    EXPECT_NEAR(at.simulation.finger_position().sum(), at.task->spec().grasp_width, 0.002);
    at.simulation.place_free_body(at.simulation.body("nut"),
                                  Pose{{0.45, 0.0, 0.010}, Eigen::Quaterniond::Identity()});
    at.simulation.forward();
  };
  const std::optional<int> steps = at.demonstrate(5, drop);
  ASSERT_TRUE(steps);
  EXPECT_GT(*steps, undisturbed + 10);
}

TEST(ScriptedOperatorAtSquare, PutsBackWhatHangsAskewInTheHandAndTakesItAnew) {
  OperatorAtTask at("square");
  const int undisturbed = at.demonstrate(5, kNothing).value_or(0);
  ASSERT_GT(undisturbed, 40);
  int opened_at = -1;
  const auto twist = [&](int step) {
    const double width = at.simulation.finger_position().sum();
    if (step > undisturbed / 2 && opened_at < 0 && width > 0.06) opened_at = step;
    if (step != undisturbed / 2) return;
    ASSERT_NEAR(width, at.task->spec().grasp_width, 0.002);
    // About the line between the fingers, so that they keep it.
    const SceneTruth truth = at.task->truth(at.simulation);
    const Pose askew =
        truth.X_WH * Pose{Eigen::Vector3d::Zero(),
                          Eigen::Quaterniond(Eigen::AngleAxisd(0.25, Eigen::Vector3d::UnitY()))};
    const Pose X_WB = at.simulation.body_pose(at.simulation.body("nut"));
    at.simulation.place_free_body(at.simulation.body("nut"), askew * (inverse(truth.X_WH) * X_WB));
    at.simulation.forward();
  };
  const std::optional<int> steps = at.demonstrate(5, twist);
  ASSERT_TRUE(steps);
  EXPECT_GT(opened_at, undisturbed / 2);
  EXPECT_LT(opened_at, *steps - 20) << "not only to leave it on the peg";
}

}  // namespace
}  // namespace tandem
