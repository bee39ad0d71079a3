#include <cmath>

#include "controller/robot/robot_fixture.h"

namespace tandem {
namespace {

using namespace testing;

class GripperTest : public RobotFixture {
 protected:
  double width() const { return robot.state().gripper_width; }
  void pass(int cycles) {
    for (int i = 0; i < cycles; ++i) robot.write(JointVector::Zero());
  }
  /// Pulls the fingers apart, each with `force` N.
  void pull_apart(double force) {
    const char* names[2] = {"left_finger", "right_finger"};
    for (const char* name : names) {
      const int body = simulation.body(name);
      const mjtNum* axes = simulation.data()->xmat + 9 * body;
      for (int i = 0; i < 3; ++i)
        simulation.data()->xfrc_applied[6 * body + i] = force * axes[3 * i + 1];
    }
  }
};

TEST_F(GripperTest, StaysForItsLatencyThenMovesAtItsSpeedAndSymmetrically) {
  robot.grip(0.0);
  pass(200);
  EXPECT_NEAR(width(), 0.04, 1e-9) << "200 ms of latency";
  pass(20);
  EXPECT_LT(width(), 0.0399);
  pass(180);
  EXPECT_NEAR(width(), 0.02, 0.003) << "0.1 m/s for 0.2 s";
  pass(600);
  EXPECT_NEAR(width(), 0.0, 5e-4);
  EXPECT_NEAR(simulation.finger_position()[0], simulation.finger_position()[1], 1e-4);
}

TEST_F(GripperTest, LatencyIsTheOptionToTheCycle) {
  for (const int latency : {0, 1, 137, 500}) {
    MujocoRobotOptions options;
    options.gripper_latency_ms = latency;
    MujocoRobot other(simulation, options);
    other.place(home(), 0.04);
    for (int i = 0; i < 777; ++i) other.miss();
    other.grip(0.06);
    int still = 0;
    while (other.state().gripper_width == 0.04 && still <= 600) {
      other.miss();
      ++still;
    }
    EXPECT_EQ(still, latency + 1) << "the first moved cycle is the one after the latency";
  }
}

TEST_F(GripperTest, TargetsArriveInOrderHoweverFastTheyFollow) {
  for (int i = 0; i < 20; ++i) {
    robot.grip(i % 2 == 0 ? 0.0 : 0.08);
    pass(1);
  }
  robot.grip(0.05);
  pass(1000);
  EXPECT_NEAR(width(), 0.05, 5e-4);
}

TEST_F(GripperTest, TargetOutOfReachIsCutAndANonFiniteOneIgnored) {
  robot.grip(1.0);
  pass(1500);
  EXPECT_NEAR(width(), 0.08, 5e-4);
  robot.grip(std::nan(""));
  pass(500);
  EXPECT_NEAR(width(), 0.08, 5e-4);
}

TEST_F(GripperTest, HoldsUpToItsForceAndYieldsBeyond) {
  for (const double force : {30.0, 50.0}) {
    robot.place(home(), 0.02);
    for (int i = 0; i < 1000; ++i) {
      pull_apart(force);
      pass(1);
    }
    if (force < 40.0) {
      EXPECT_LT(width(), 0.04) << "a spring of 4000 N/m, not open";
    } else {
      EXPECT_GT(width(), 0.075) << "40 N do not hold against 50 N";
    }
  }
}

TEST_F(GripperTest, WorksOnAtFault) {
  robot.write(on_joint(0, 2.0));
  ASSERT_EQ(robot.state().mode, RobotMode::reflex);
  robot.grip(0.08);
  pass(1000);
  EXPECT_NEAR(width(), 0.08, 5e-4) << "so that a trapped object can be let go";
}

}  // namespace
}  // namespace tandem
