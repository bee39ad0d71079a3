// Every declared end of a motion: asked for, cut off, or by the robot's own button.
#include <cmath>

#include "controller/robot/robot_fixture.h"

namespace tandem {
namespace {

using namespace testing;

class MotionEndTest : public RobotFixture {
 protected:
  /// finish() until it returns true. @returns cycles it took.
  int finish_cycles(MujocoRobot& robot) {
    for (int i = 1; i <= 2000; ++i) {
      if (robot.finish()) return i;
    }
    return -1;
  }
};

//------------------------------ finish ------------------------------

TEST_F(MotionEndTest, FinishBrakesWhileMovingAndIsIdleWhenTheArmStands) {
  swing();
  const double began = robot.state().q[0];
  int cycles = 0;
  while (!robot.finish()) {
    ++cycles;
    ASSERT_LT(cycles, 1000);
    ASSERT_EQ(robot.state().mode, RobotMode::moving) << "not idle before it stands";
    ASSERT_EQ(robot.state().success_rate, 1.0) << "the end asked for is a command";
  }
  EXPECT_GT(cycles, 20) << "a moving arm does not stand at once";
  EXPECT_LT(cycles, 500);
  EXPECT_EQ(robot.state().mode, RobotMode::idle);
  EXPECT_EQ(robot.state().fault, Fault::none);
  EXPECT_EQ(robot.state().success_rate, 0.0);
  EXPECT_LT(speed(robot), 0.005);
  EXPECT_LT(robot.state().q[0] - began, 0.05) << "rad, way to stand still";
  const JointVector rest = robot.state().q;
  for (int i = 0; i < 500; ++i) robot.miss();
  EXPECT_LT((robot.state().q - rest).cwiseAbs().maxCoeff(), 5e-4) << "and it stays there";
}

TEST_F(MotionEndTest, FinishEndsThoughSomethingKeepsTurningTheHand) {
  // As fingers do that squeeze something awry.
  robot.simulation().push((Wrench() << 0, 0, 0, 0, 0, 1.5).finished());
  for (int i = 0; i < 50; ++i) robot.write(on_joint(6, 1.0));
  EXPECT_LT(finish_cycles(robot), 500);
  EXPECT_EQ(robot.state().fault, Fault::none);
}

TEST_F(MotionEndTest, FinishOfAnArmAtRestTakesTenCyclesAndOfAnIdleOneTakesOne) {
  for (int i = 0; i < 50; ++i) robot.write(JointVector::Zero());
  EXPECT_EQ(finish_cycles(robot), 10);
  EXPECT_EQ(finish_cycles(robot), 1);
  EXPECT_EQ(robot.state().cycle, 61u) << "every call passes a cycle";
}

TEST_F(MotionEndTest, FinishLeavesANewMotionToStartFromZeroTorque) {
  swing();
  ASSERT_GT(finish_cycles(robot), 0);
  robot.write(on_joint(0, 5.0));
  EXPECT_EQ(robot.state().fault, Fault::torque_discontinuity);
}

TEST_F(MotionEndTest, FinishOfAnArmAtRestHoldsItWhereItIsNotWhereTheMotionBegan) {
  const JointVector aside = home() + on_joint(0, 0.05) + on_joint(6, -0.1);
  for (int i = 0; i < 2000; ++i) follow(robot, aside, JointVector::Zero());
  const JointVector rest = robot.state().q;
  ASSERT_LT((rest - aside).cwiseAbs().maxCoeff(), 1e-3);
  robot.finish();
  EXPECT_LT(robot.state().tau_measured.cwiseAbs().maxCoeff(), 1.0) << "the brakes do not kick";
  ASSERT_GT(finish_cycles(robot), 0);
  for (int i = 0; i < 300; ++i) robot.miss();
  EXPECT_LT((robot.state().q - rest).cwiseAbs().maxCoeff(), 1e-3);
}

TEST_F(MotionEndTest, SilenceDuringFinishCountsAsMissesAndTheRobotStillBrakes) {
  swing();
  robot.finish();
  const double began = robot.state().dq[0];
  for (int i = 0; i < 19; ++i) robot.miss();
  EXPECT_EQ(robot.state().mode, RobotMode::moving);
  EXPECT_EQ(robot.state().fault, Fault::none);
  EXPECT_LT(robot.state().dq[0], 0.5 * began) << "the last torque is not used again";
  robot.miss();
  EXPECT_EQ(robot.state().fault, Fault::communication_constraints_violation);
  expect_held(300);
}

TEST_F(MotionEndTest, OneFinishInTwentyCyclesIsEnoughToEndWell) {
  swing();
  bool over = false;
  for (int i = 0; i < 1000 && !over; ++i) {
    if (i % 20 == 0) {
      over = robot.finish();
    } else {
      robot.miss();
      over = robot.state().mode != RobotMode::moving;
    }
  }
  EXPECT_EQ(robot.state().mode, RobotMode::idle);
  EXPECT_EQ(robot.state().fault, Fault::none);
}

TEST_F(MotionEndTest, TorqueDuringFinishIsNotAppliedAndCountsAsAMiss) {
  swing();
  robot.finish();
  for (int i = 0; i < 19; ++i) {
    robot.write(on_joint(0, 5.0));
    ASSERT_LT(robot.state().tau_measured[0], 0.0) << "it brakes";
  }
  EXPECT_EQ(robot.state().fault, Fault::none);
  robot.write(on_joint(0, 5.0));
  EXPECT_EQ(robot.state().fault, Fault::communication_constraints_violation);
}

TEST_F(MotionEndTest, ArmThatIsShakenTimesOutAfterOneSecond) {
  MujocoRobotOptions options;
  options.collision_force.setConstant(500.0);
  options.collision_torque.setConstant(500.0);
  MujocoRobot shaken(simulation, options);
  shaken.place(home(), 0.04);
  for (int i = 0; i < 10; ++i) shaken.write(JointVector::Zero());
  bool over = false;
  int cycles = 0;
  while (!over) {
    ASSERT_LE(cycles, 1000);
    if (cycles % 40 == 0) shaken.push(Eigen::Vector3d(0, cycles % 80 == 0 ? 60 : -60, 0), 40);
    over = shaken.finish();
    ++cycles;
    if (cycles == 999) {
      EXPECT_EQ(shaken.state().fault, Fault::none);
    }
  }
  EXPECT_EQ(cycles, 1000);
  EXPECT_EQ(shaken.state().fault, Fault::finish_timeout);
  EXPECT_EQ(shaken.state().mode, RobotMode::reflex);
  EXPECT_FALSE(shaken.recover()) << "it still moves";
  for (int i = 0; i < 500; ++i) shaken.miss();
  EXPECT_EQ(shaken.state().fault, Fault::finish_timeout);
  EXPECT_TRUE(shaken.recover());
  EXPECT_EQ(shaken.state().mode, RobotMode::idle);
}

TEST_F(MotionEndTest, FinishAfterAFaultIsOverAndLeavesTheFault) {
  swing();
  robot.write(on_joint(0, std::nan("")));
  EXPECT_TRUE(robot.finish());
  EXPECT_EQ(robot.state().fault, Fault::not_finite);
  EXPECT_EQ(robot.state().mode, RobotMode::reflex);
}

TEST_F(MotionEndTest, ReflexesWatchOverTheEndOfAMotion) {
  swing();
  robot.push(Eigen::Vector3d(0, 0, 150), 200);
  EXPECT_GT(finish_cycles(robot), 0);
  EXPECT_EQ(robot.state().fault, Fault::collision);
}

//------------------------------ stop button ------------------------------

TEST_F(MotionEndTest, StopButtonLatchesBrakesAndNeedsReleaseAndRecovery) {
  swing();
  robot.press_stop(true);
  EXPECT_EQ(robot.state().mode, RobotMode::user_stopped);
  EXPECT_EQ(robot.state().fault, Fault::user_stop);
  EXPECT_EQ(robot.state().success_rate, 0.0);
  expect_held(500);
  EXPECT_EQ(robot.state().mode, RobotMode::user_stopped);
  EXPECT_FALSE(robot.recover()) << "still pressed";
  robot.press_stop(false);
  robot.write(JointVector::Zero());
  EXPECT_EQ(robot.state().mode, RobotMode::user_stopped) << "release alone does not start it";
  EXPECT_TRUE(robot.recover());
  EXPECT_EQ(robot.state().mode, RobotMode::idle);
  EXPECT_EQ(robot.state().fault, Fault::none);
  robot.write(JointVector::Zero());
  EXPECT_EQ(robot.state().mode, RobotMode::moving);
}

TEST_F(MotionEndTest, StopButtonWorksOnAnIdleRobotAndDuringFinish) {
  robot.press_stop(true);
  EXPECT_EQ(robot.state().fault, Fault::user_stop);
  robot.write(JointVector::Zero());
  EXPECT_EQ(robot.state().mode, RobotMode::user_stopped);
  robot.press_stop(false);
  ASSERT_TRUE(robot.recover());
  swing();
  EXPECT_FALSE(robot.finish());
  robot.press_stop(true);
  EXPECT_TRUE(robot.finish());
  EXPECT_EQ(robot.state().fault, Fault::user_stop);
}

TEST_F(MotionEndTest, StopButtonAfterAFaultLeavesTheFirstFault) {
  robot.write(on_joint(0, 2.0));
  ASSERT_EQ(robot.state().fault, Fault::torque_discontinuity);
  robot.press_stop(true);
  EXPECT_EQ(robot.state().mode, RobotMode::user_stopped);
  EXPECT_EQ(robot.state().fault, Fault::torque_discontinuity);
  EXPECT_FALSE(robot.recover());
  robot.press_stop(false);
  EXPECT_TRUE(robot.recover());
}

//------------------------------ stop, recovery ------------------------------

TEST_F(MotionEndTest, StopHoldsStillAndTheNextMotionStartsFromZeroTorque) {
  for (int i = 0; i < 150; ++i) robot.write(on_joint(1, std::min(5.0, 0.9 * i)));
  robot.stop();
  EXPECT_EQ(robot.state().mode, RobotMode::idle);
  for (int i = 0; i < 500; ++i) robot.miss();
  const JointVector rest = robot.state().q;
  for (int i = 0; i < 500; ++i) robot.miss();
  EXPECT_LT((robot.state().q - rest).norm(), 1e-4);
  robot.write(on_joint(1, 5.0));
  EXPECT_EQ(robot.state().fault, Fault::torque_discontinuity);
}

TEST_F(MotionEndTest, RecoveryWaitsUntilTheArmStands) {
  swing();
  robot.write(on_joint(0, std::nan("")));
  EXPECT_FALSE(robot.recover());
  EXPECT_EQ(robot.state().fault, Fault::not_finite) << "a refused recovery changes nothing";
  EXPECT_EQ(robot.state().mode, RobotMode::reflex);
  for (int i = 0; i < 500; ++i) robot.miss();
  EXPECT_TRUE(robot.recover());
}

TEST_F(MotionEndTest, RecoveryWithoutAFaultLeavesTheMotionAlone) {
  swing();
  EXPECT_TRUE(robot.recover());
  EXPECT_EQ(robot.state().mode, RobotMode::moving);
}

TEST_F(MotionEndTest, NoFaultIsClearedByTimeCommandsOrCarryingTheArm) {
  robot.write(on_joint(0, 2.0));
  ASSERT_EQ(robot.state().fault, Fault::torque_discontinuity);
  for (int i = 0; i < 2000; ++i) robot.write(JointVector::Zero());
  robot.finish();
  robot.stop();
  robot.place(home(), 0.04);
  robot.press_stop(false);
  EXPECT_EQ(robot.state().fault, Fault::torque_discontinuity);
  EXPECT_EQ(robot.state().mode, RobotMode::reflex);
}

}  // namespace
}  // namespace tandem
