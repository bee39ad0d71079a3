#pragma once

#include <gtest/gtest.h>

#include <algorithm>

#include "controller/robot/mujoco_robot.h"
#include "controller/robot/scenes.h"

namespace tandem::testing {

inline JointVector on_joint(int joint, double torque) {
  JointVector tau = JointVector::Zero();
  tau[joint] = torque;
  return tau;
}

inline double speed(const Robot& robot) { return robot.state().dq.cwiseAbs().maxCoeff(); }

/// The bare arm, tool down, over its table.
class RobotFixture : public ::testing::Test {
 protected:
  void SetUp() override { robot.place(home(), 0.04); }

  /// Joint 1 turns at about 0.6 rad/s, the tool at 0.3 m/s.
  void swing() {
    for (int i = 0; i < 200; ++i) robot.write(on_joint(0, std::min(5.0, 0.9 * i)));
    ASSERT_EQ(robot.state().mode, RobotMode::moving);
    ASSERT_GT(robot.state().dq[0], 0.3);
  }

  /// At fault or idle the arm comes to rest within 0.5 s and stays, whatever is written to it.
  void expect_held(int cycles) {
    for (int i = 0; i < 500; ++i) robot.miss();
    const JointVector rest = robot.state().q;
    for (int i = 0; i < cycles; ++i) robot.write(JointVector::Zero());
    EXPECT_LT((robot.state().q - rest).cwiseAbs().maxCoeff(), 1e-4);
    EXPECT_LT(speed(robot), 1e-3);
  }

  /// One cycle of a joint impedance, as a well-behaved controller commands it but for the noise
  /// (N m): follows q (rad) at dq (rad/s).
  static void follow(MujocoRobot& robot, const JointVector& q, const JointVector& dq,
                     const JointVector& noise = JointVector::Zero()) {
    JointVector K, D, limit;
    K << 600, 600, 600, 600, 150, 150, 150;
    D << 50, 50, 50, 50, 8, 8, 8;
    limit << 87, 87, 87, 87, 12, 12, 12;
    const RobotState& state = robot.state();
    const JointVector wanted = K.cwiseProduct(q - state.q) + D.cwiseProduct(dq - state.dq);
    const JointVector step = (wanted - state.tau_commanded).cwiseMax(-0.99).cwiseMin(0.99);
    robot.write((state.tau_commanded + step + noise).cwiseMax(-limit).cwiseMin(limit));
  }
  static void hold(MujocoRobot& robot, const JointVector& noise = JointVector::Zero()) {
    follow(robot, home(), JointVector::Zero(), noise);
  }

  Simulation simulation{kArmScene};
  MujocoRobot robot{simulation};
};

}  // namespace tandem::testing
