#include "controller/task/square.h"

#include <gtest/gtest.h>

#include <cmath>

#include "controller/rig.h"
#include "controller/task/reset.h"

namespace tandem {
namespace {

using testing::Rig;

struct SquareRig : Rig {
  explicit SquareRig(const std::string& name = "square")
      : Rig({.mode = ExecutionMode::open_loop, .horizon = kHorizon, .execute = kHorizon}, name) {}

  int nut = simulation.body("nut");

  SceneTruth truth() const { return task->truth(simulation); }

  /// Drops the nut onto the peg, turned by `yaw` from the way it fits. @returns how far its lower
  /// face has come below the peg's top, m.
  double drop(double yaw) {
    begin(1);
    const Pose X_BO{{0.0, 0.0, -0.01}, Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0)};
    const Pose X_GO{{0.0, 0.0, 0.003}, Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0)};
    Pose X_WG = truth().X_WG;
    X_WG.R = X_WG.R * Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ());
    simulation.place_free_body(nut, X_WG * X_GO * inverse(X_BO));
    simulation.forward();
    for (int i = 0; i < 1000; ++i) robot.miss();
    return -(inverse(truth().X_WG) * truth().X_WO).p.z();
  }

  /// Takes the nut by its handle and lifts it by 120 mm.
  void take() {
    begin(1, Phase::demonstration);
    const Pose X_WB = simulation.body_pose(nut);
    place_arm(robot, model, truth().X_WH, kGripperStroke);
    simulation.place_free_body(nut, X_WB);
    simulation.forward();
    robot.recover();
    loop.begin_episode({.episode = 0, .episode_seed = 1, .phase = Phase::demonstration});
    move(0.0, 8);
    move(1.0, 8);
    move(0.0, 5);
  }

  /// Policy steps of a human who keeps the hand closed; `up` as an action, 1 = the task's limit.
  void move(double up, int steps) {
    HumanCommand command = human(up * Twist::Unit(2), true);
    command.gripper = 1.0;
    for (int i = 0; i < steps; ++i) {
      loop.hear(command, now_us);
      begin_step();
      run_step();
    }
  }

  /// The nut's orientation in E.
  Eigen::Quaterniond nut_in_hand() const {
    return simulation.tool_pose().R.conjugate() * simulation.body_pose(nut).R;
  }
};

TEST(SquareTask, SameSeedGivesTheSameSceneWhateverHappenedBefore) {
  SquareRig rig;
  rig.begin(11);
  const SceneTruth first = rig.truth();
  for (int i = 0; i < 3; ++i) rig.run_step();
  rig.begin(12);
  EXPECT_NE(first.X_WO.p, rig.truth().X_WO.p);
  rig.drop(0.4);
  rig.begin(11);
  EXPECT_EQ(first.X_WO.p, rig.truth().X_WO.p);
  EXPECT_EQ(first.X_WO.R.coeffs(), rig.truth().X_WO.R.coeffs());
  EXPECT_EQ(first.X_WG.p, rig.truth().X_WG.p);
}

TEST(SquareTask, NutLiesStillUntilItIsTouched) {
  SquareRig rig;
  rig.begin(3);
  const Pose before = rig.truth().X_WO;
  for (int i = 0; i < 1000; ++i) rig.robot.miss();
  EXPECT_LT(minus(rig.truth().X_WO, before).norm(), 1e-3);
}

TEST(SquareTask, HeldNutDoesNotTurnUnderALoadThatFrictionBears) {
  for (const char* name : {"square", "square-robosuite"}) {
    SquareRig rig(name);
    rig.take();
    const Eigen::Quaterniond before = rig.nut_in_hand();
    ASSERT_GT(rig.simulation.body_pose(rig.nut).p.z(), 0.1) << "not taken";
    double* force = rig.simulation.data()->xfrc_applied + 6 * rig.nut;
    force[2] = 6.0;  // as from a peg below the hole, 60 mm beside the fingers
    rig.move(0.0, 10);
    EXPECT_LT(before.angularDistance(rig.nut_in_hand()), 0.01) << name;
  }
}

TEST(SquareTask, TightNutNeedsTheRightYaw) {
  SquareRig rig;
  EXPECT_GT(rig.drop(0.0), 0.055);
  EXPECT_LT(rig.drop(0.4), 0.005);
}

TEST(SquareTask, NutOfRobosuiteFitsAtAnyYaw) {
  SquareRig rig("square-robosuite");
  EXPECT_GT(rig.drop(0.0), 0.12);
  EXPECT_GT(rig.drop(M_PI / 4), 0.12);
}

TEST(SquareTask, GoalIsTheNearestOfTheFourWaysThatFit) {
  SquareRig rig("square-robosuite");  // its nut lies at up to 90 degrees
  double largest = 0.0;
  for (uint64_t seed = 0; seed < 30; ++seed) {
    rig.begin(seed);
    const Pose X_GO = inverse(rig.truth().X_WG) * rig.truth().X_WO;
    const double turn = std::abs(log_map(X_GO.R * Eigen::Quaterniond(0, 1, 0, 0)).z());
    EXPECT_LE(turn, M_PI / 4 + 1e-9);
    largest = std::max(largest, turn);
  }
  EXPECT_GT(largest, 0.5);
}

TEST(SquareTask, SuccessAsksToLetGo) {
  SquareRig rig;
  rig.drop(0.0);
  EXPECT_TRUE(rig.task->succeeded(rig.truth(), rig.simulation));
  const Pose X_WB = rig.simulation.body_pose(rig.nut);
  rig.simulation.set_arm(rig.simulation.q(), 0.032);  // fingers as when they hold the handle
  rig.simulation.place_free_body(rig.nut, X_WB);
  rig.simulation.forward();
  EXPECT_FALSE(rig.task->succeeded(rig.truth(), rig.simulation));
  rig.simulation.set_arm(rig.simulation.q(), 0.0);
  rig.simulation.place_free_body(rig.nut, X_WB);
  rig.simulation.forward();
  EXPECT_TRUE(rig.task->succeeded(rig.truth(), rig.simulation)) << "closed upon nothing";
}

TEST(SquareTask, PolicyThatSeesIsNotToldWhereThingsAre) {
  SquareRig rig;
  std::vector<std::string> expected;  // as `observed` of scenario.py says it
  for (const std::string& name : rig.task->observation().names())
    if (name.rfind("goal", 0) && name.rfind("object", 0)) expected.push_back(name);
  rig.task->hide_truth();
  EXPECT_EQ(rig.task->observation().names(), expected);
  EXPECT_LT(expected.size(), 24u);
}

}  // namespace
}  // namespace tandem
