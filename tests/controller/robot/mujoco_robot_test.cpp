#include "controller/robot/mujoco_robot.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "controller/robot/scenes.h"
#include "support/allocation_counter.h"

namespace tandem {
namespace {

using namespace testing;

class MujocoRobotTest : public ::testing::Test {
 protected:
  void SetUp() override { robot.place(home(), 0.04); }

  static JointVector on_joint(int joint, double torque) {
    JointVector tau = JointVector::Zero();
    tau[joint] = torque;
    return tau;
  }
  void expect_held(int cycles) {
    for (int i = 0; i < 500; ++i) robot.miss();
    const JointVector rest = robot.state().q;
    for (int i = 0; i < cycles; ++i) robot.write(JointVector::Zero());
    EXPECT_LT((robot.state().q - rest).cwiseAbs().maxCoeff(), 1e-4);
    EXPECT_LT(robot.state().dq.cwiseAbs().maxCoeff(), 1e-3);
  }

  Simulation simulation{kArmScene};
  MujocoRobot robot{simulation};
};

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
  for (int i = 0; i < 1000 && robot.state().fault == Fault::none; ++i)
    robot.write(on_joint(6, std::min(6.0, 0.9 * i)));
  EXPECT_EQ(robot.state().fault, Fault::joint_velocity_limit);
  EXPECT_GT(robot.state().dq[6], 2.61);
}

TEST_F(MujocoRobotTest, CollisionIsAFaultAndTheForceIsMeasured) {
  ArmModel arm(kUrdf);
  ArmState state;
  MujocoRobotOptions options;
  options.collision_force = 25.0;
  MujocoRobot careful(simulation, options);
  careful.place(
      arm.solve_ik({Eigen::Vector3d(0.5, 0, 0.03), Eigen::Quaterniond(0, 1, 0, 0)}, home()), 0.0);
  JointVector tau = JointVector::Zero();
  double largest = 0;
  for (int i = 0; i < 2000 && careful.state().fault == Fault::none; ++i) {
    arm.update(careful.state().q, careful.state().dq, state);
    const JointVector wanted =
        state.J.transpose() * (Wrench() << 0, 0, -40.0 - 300 * state.V_WE[2], 0, 0, 0).finished() -
        5 * careful.state().dq;
    tau += (wanted - tau).cwiseMax(-0.9).cwiseMin(0.9);
    careful.write(tau);
    largest = std::max(largest, careful.state().tau_external.cwiseAbs().maxCoeff());
  }
  EXPECT_EQ(careful.state().fault, Fault::collision);
  EXPECT_GT(largest, 5.0);
}

TEST_F(MujocoRobotTest, StopHoldsStillAndTheNextMotionStartsFromZeroTorque) {
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

TEST_F(MujocoRobotTest, GripperMovesAtItsOwnSpeedAndStaysSymmetric) {
  robot.grip(0.0);
  EXPECT_NEAR(robot.state().gripper_width, 0.04, 1e-9) << "grip() returns at once";
  for (int i = 0; i < 200; ++i) robot.write(JointVector::Zero());
  EXPECT_NEAR(robot.state().gripper_width, 0.02, 0.003) << "0.1 m/s for 0.2 s";
  for (int i = 0; i < 600; ++i) robot.write(JointVector::Zero());
  EXPECT_NEAR(robot.state().gripper_width, 0.0, 5e-4);
  EXPECT_NEAR(simulation.finger_position()[0], simulation.finger_position()[1], 1e-4);
}

TEST_F(MujocoRobotTest, LostPacketsComeFromTheSeedAndCountAsMisses) {
  const auto run = [](uint64_t seed) {
    Simulation other(kArmScene);
    MujocoRobotOptions options;
    options.packet_loss = 0.1;
    options.seed = seed;
    MujocoRobot lossy(other, options);
    lossy.place(home(), 0.04);
    std::string received;
    for (int i = 0; i < 1000; ++i) {
      lossy.write(on_joint(0, i % 2 == 0 ? 0.1 : 0.2));
      received += lossy.state().tau_commanded[0] == (i % 2 == 0 ? 0.1 : 0.2) ? '1' : '0';
    }
    return received;
  };
  const std::string first = run(7);
  EXPECT_EQ(first, run(7));
  EXPECT_NE(first, run(8));
  EXPECT_NEAR(static_cast<double>(std::count(first.begin(), first.end(), '0')), 100, 40);
}

TEST_F(MujocoRobotTest, NothingAllocatesAfterConstruction) {
  AllocationCounter allocations;
  for (int i = 0; i < 100; ++i) {
    robot.write(on_joint(0, 0.5));
    if (robot.state().mode != RobotMode::moving) robot.recover();
  }
  robot.grip(0.01);
  for (int i = 0; i < 25; ++i) robot.miss();
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
  for (int i = 0; i <= 7; ++i) {
    for (int j = 0; j < i; ++j)
      EXPECT_STRNE(fault_text(static_cast<Fault>(i)), fault_text(static_cast<Fault>(j)));
  }
}

}  // namespace
}  // namespace tandem
