#include "controller/robot/mujoco_robot.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <string>
#include <vector>

#include "controller/robot/robot_fixture.h"
#include "support/allocation_counter.h"

namespace tandem {
namespace {

using namespace testing;

using MujocoRobotTest = RobotFixture;

TEST_F(MujocoRobotTest, IsIdleAndHoldsUntilTheFirstCommand) {
  EXPECT_EQ(robot.state().mode, RobotMode::idle);
  EXPECT_EQ(robot.state().success_rate, 0.0);
  for (int i = 0; i < 100; ++i) robot.miss();
  EXPECT_EQ(robot.state().mode, RobotMode::idle);
  EXPECT_EQ(robot.state().fault, Fault::none);
  EXPECT_EQ(robot.state().cycle, 100u);
  EXPECT_LT((robot.state().q - home()).norm(), 1e-9);
  robot.write(JointVector::Zero());
  EXPECT_EQ(robot.state().mode, RobotMode::moving);
}

TEST_F(MujocoRobotTest, GravityIsCompensated) {
  for (int i = 0; i < 1000; ++i) robot.write(JointVector::Zero());
  EXPECT_LT((robot.state().q - home()).norm(), 1e-9);
  EXPECT_LT(robot.state().tau_external.norm(), 1e-12);
  EXPECT_EQ(robot.state().success_rate, 1.0);
}

TEST_F(MujocoRobotTest, NineteenMissesInARowAreNoFaultAndTheTwentiethIs) {
  robot.write(JointVector::Zero());
  for (int i = 0; i < 19; ++i) robot.miss();
  EXPECT_EQ(robot.state().fault, Fault::none);
  EXPECT_EQ(robot.state().mode, RobotMode::moving);
  robot.write(JointVector::Zero());
  for (int i = 0; i < 19; ++i) robot.miss();
  EXPECT_EQ(robot.state().fault, Fault::none) << "a command must end the count";
  robot.miss();
  EXPECT_EQ(robot.state().fault, Fault::communication_constraints_violation);
  EXPECT_EQ(robot.state().mode, RobotMode::reflex);
}

TEST_F(MujocoRobotTest, MissedCycleUsesTheLastTorqueAgain) {
  robot.write(on_joint(0, 0.9));
  const double speed = robot.state().dq[0];
  robot.miss();
  EXPECT_EQ(robot.state().tau_measured, on_joint(0, 0.9));
  EXPECT_NEAR(robot.state().dq[0], 2 * speed, 0.02 * speed);
}

TEST_F(MujocoRobotTest, SuccessRateIsTheShareOfTheLastHundredCycles) {
  for (int i = 0; i < 200; ++i) {
    if (i % 4 == 3) {
      robot.miss();
    } else {
      robot.write(JointVector::Zero());
    }
  }
  EXPECT_DOUBLE_EQ(robot.state().success_rate, 0.75);
  for (int i = 0; i < 100; ++i) robot.write(JointVector::Zero());
  EXPECT_DOUBLE_EQ(robot.state().success_rate, 1.0);
  robot.stop();
  EXPECT_EQ(robot.state().success_rate, 0.0);
}

TEST_F(MujocoRobotTest, LimiterJustBelowTheTorqueRateNeverTrips) {
  const double step = (1000.0 - 1e-3) * 1e-3;
  double torque = 0.0;
  for (int i = 0; i < 30; ++i) robot.write(on_joint(0, torque += step));
  for (int i = 0; i < 60; ++i) robot.write(on_joint(0, torque -= step));
  for (int i = 0; i < 30; ++i) robot.write(on_joint(0, torque += step));
  EXPECT_EQ(robot.state().fault, Fault::none);
}

TEST_F(MujocoRobotTest, TorqueStepBeyondOneNewtonMetreIsAFaultAlsoAtTheFirstCommand) {
  robot.write(on_joint(2, 1.001));
  EXPECT_EQ(robot.state().fault, Fault::torque_discontinuity);
  EXPECT_EQ(robot.state().tau_commanded, JointVector::Zero()) << "a refused command is not applied";
  ASSERT_TRUE(robot.recover());
  robot.write(on_joint(2, 0.9));
  EXPECT_EQ(robot.state().fault, Fault::none);
  robot.write(on_joint(2, -0.2));
  EXPECT_EQ(robot.state().fault, Fault::torque_discontinuity);
}

TEST_F(MujocoRobotTest, TorqueOutOfRangeIsAFault) {
  for (int i = 1; i <= 12; ++i) robot.write(on_joint(6, 0.9 * i));
  ASSERT_EQ(robot.state().fault, Fault::none);
  robot.write(on_joint(6, 11.7));
  robot.write(on_joint(6, 12.1));
  EXPECT_EQ(robot.state().fault, Fault::torque_range);
}

TEST_F(MujocoRobotTest, NonFiniteCommandIsAFaultAndNeverApplied) {
  for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    robot.place(home(), 0.04);
    robot.write(on_joint(3, bad));
    EXPECT_EQ(robot.state().fault, Fault::not_finite);
    EXPECT_TRUE(robot.state().q.allFinite());
    EXPECT_TRUE(robot.state().tau_measured.allFinite());
    ASSERT_TRUE(robot.recover());
  }
}

TEST_F(MujocoRobotTest, FaultIsLatchedTheFirstOneStaysAndTheRobotBrakes) {
  for (int i = 0; i < 200; ++i) robot.write(on_joint(0, std::min(5.0, 0.9 * i)));
  ASSERT_GT(robot.state().dq[0], 0.3);
  robot.write(on_joint(0, std::nan("")));
  const double at_fault = robot.state().q[0];
  robot.write(on_joint(0, 50.0));
  EXPECT_EQ(robot.state().fault, Fault::not_finite);
  expect_held(1000);
  EXPECT_LT(robot.state().q[0] - at_fault, 0.05) << "rad, way to stand still";
  EXPECT_EQ(robot.state().mode, RobotMode::reflex);
  ASSERT_TRUE(robot.recover());
  EXPECT_EQ(robot.state().mode, RobotMode::idle);
  EXPECT_EQ(robot.state().fault, Fault::none);
}

TEST_F(MujocoRobotTest, JointBeyondItsPositionLimitIsAFaultThatCannotBeRecoveredInPlace) {
  JointVector q = home();
  q[5] = 3.7;  // limit 3.7525
  robot.place(q, 0.04);
  for (int i = 0; i < 400 && robot.state().fault == Fault::none; ++i)
    robot.write(on_joint(5, std::min(3.0, 0.5 * i)));
  EXPECT_EQ(robot.state().fault, Fault::joint_position_limit);
  q[5] = 3.9;
  robot.place(q, 0.04);
  EXPECT_FALSE(robot.recover());
  robot.place(home(), 0.04);
  EXPECT_EQ(robot.state().fault, Fault::joint_position_limit)
      << "carrying the arm does not clear the fault";
  EXPECT_TRUE(robot.recover());
}

TEST_F(MujocoRobotTest, JointFasterThanItsLimitIsAFault) {
  for (int i = 0; i < 2000 && robot.state().fault == Fault::none; ++i)
    robot.write(on_joint(0, std::min(10.0, 0.9 * i)));
  EXPECT_EQ(robot.state().fault, Fault::joint_velocity_limit);
  EXPECT_GT(robot.state().dq[0], 2.175);
  EXPECT_LT(robot.state().dq[0], 2.2);
}

TEST_F(MujocoRobotTest, NothingAllocatesAfterConstruction) {
  Injection everything;
  everything.lost_commands = everything.burst = everything.corruption = everything.push = 0.02;
  everything.user_stop = everything.deaf_gripper = 0.02;
  robot.inject(everything);
  AllocationCounter allocations;
  for (int i = 0; i < 2000; ++i) {
    robot.write(on_joint(0, 0.5));
    robot.grip(0.00001 * i);
    if (robot.state().mode != RobotMode::moving) robot.recover();
    if (i % 50 == 49) robot.finish();
    if (i % 500 == 499) robot.seed_faults(static_cast<uint64_t>(i));
  }
  for (int i = 0; i < 25; ++i) robot.miss();
  robot.press_stop(true);
  robot.press_stop(false);
  robot.recover();
  robot.stop();
  robot.place(home(), 0.04);
  EXPECT_EQ(allocations.count(), 0);
}

TEST(AllocationCounter, SeesAnAllocation) {
  AllocationCounter allocations;
  std::vector<int>* const made = new std::vector<int>(100);
  EXPECT_GE(allocations.count(), 1);
  delete made;
}

TEST(Fault, EveryFaultHasItsOwnClause) {
  std::set<std::string> clauses;
  int faults = 0;
  for (int i = 0; i <= static_cast<int>(Fault::estop); ++i) {
    const std::string clause = fault_text(static_cast<Fault>(i));
    if (clause == "an unknown fault") continue;
    ++faults;
    clauses.insert(clause);
  }
  EXPECT_EQ(faults, 15) << "none, ten of the robot's, four of the controller's";
  EXPECT_EQ(clauses.size(), 15u);
}

}  // namespace
}  // namespace tandem
