// What the robot does about the world by itself: it tells contact, and it stops.
#include "controller/robot/robot_fixture.h"

namespace tandem {
namespace {

using namespace testing;

class ReflexTest : public RobotFixture {
 protected:
  /// Holds the arm at home while the tool is pushed by F_W.
  Fault pushed(MujocoRobot& robot, const Wrench& F_W, int cycles) {
    simulation.push(F_W);
    for (int i = 0; i < cycles && robot.state().fault == Fault::none; ++i) hold(robot);
    const Fault fault = robot.state().fault;
    simulation.push(Wrench::Zero());
    return fault;
  }
  static Wrench on_axis(int axis, double value) {
    Wrench F = Wrench::Zero();
    F[axis] = value;
    return F;
  }
  Twist tool_velocity() {
    ArmModel arm(kUrdf);
    ArmState state;
    arm.update(robot.state().q, robot.state().dq, state);
    return state.V_WE;
  }
};

TEST_F(ReflexTest, ContactIsToldPerAxisWithItsSignAndIsNoFault) {
  for (int axis = 0; axis < 6; ++axis) {
    const double threshold = axis < 3 ? 5.0 : 1.0;
    for (const double sign : {-1.0, 1.0}) {
      for (const double share : {0.98, 1.02}) {
        robot.place(home(), 0.04);
        EXPECT_EQ(pushed(robot, on_axis(axis, sign * share * threshold), 300), Fault::none);
        for (int other = 0; other < 6; ++other) {
          const int expected = other == axis && share > 1.0 ? static_cast<int>(sign) : 0;
          EXPECT_EQ(robot.state().contact_W[other], expected)
              << "axis " << axis << ", flag " << other << ", share " << share;
        }
      }
    }
  }
}

TEST_F(ReflexTest, ContactIsToldPerJointAndEndsWithThePush) {
  EXPECT_EQ(pushed(robot, on_axis(1, 25.0), 300), Fault::none);
  EXPECT_EQ(robot.state().contact_joint[0], 1) << "25 N, 0.3 m off joint 1";
  EXPECT_EQ(robot.state().contact_joint[1], 0) << "25 N within the plane of its axis";
  for (int i = 0; i < 200; ++i) hold(robot);
  for (const int8_t flag : robot.state().contact_joint) EXPECT_EQ(flag, 0);
  for (const int8_t flag : robot.state().contact_W) EXPECT_EQ(flag, 0);
}

TEST_F(ReflexTest, ContactNeedsMoreThanAShortPeak) {
  EXPECT_EQ(pushed(robot, on_axis(0, 25.0), 4), Fault::none);
  EXPECT_EQ(robot.state().contact_W[0], 0) << "25 N for 4 ms average to less than 5 N";
  EXPECT_EQ(pushed(robot, on_axis(0, 25.0), 5), Fault::none);
  EXPECT_EQ(robot.state().contact_W[0], 1);
}

TEST_F(ReflexTest, PushIsFeltInTheJointsAsTheJacobianSays) {
  ArmModel arm(kUrdf);
  ArmState before;
  const Wrench F = (Wrench() << 3, -2, 4, 0.5, -0.3, 0.2).finished();
  for (int i = 0; i < 100; ++i) {
    arm.update(robot.state().q, robot.state().dq, before);
    simulation.push(F);
    hold(robot);
    const JointVector expected = before.J.transpose() * F;
    EXPECT_LT((expected - robot.state().tau_external).cwiseAbs().maxCoeff(), 1e-9);
    EXPECT_LT((simulation.contact_wrench() - F).cwiseAbs().maxCoeff(), 1e-9);
  }
}

TEST_F(ReflexTest, ForceOrMomentBeyondTheThresholdOfItsAxisIsACollision) {
  MujocoRobotOptions options;
  options.collision_force << 20, 20, 20, 4, 4, 4;
  MujocoRobot careful(simulation, options);
  for (int axis = 0; axis < 6; ++axis) {
    const double threshold = options.collision_force[axis];
    for (const double sign : {-1.0, 1.0}) {
      careful.place(home(), 0.04);
      EXPECT_EQ(pushed(careful, on_axis(axis, 0.98 * sign * threshold), 400), Fault::none) << axis;
      careful.place(home(), 0.04);
      EXPECT_EQ(pushed(careful, on_axis(axis, 1.02 * sign * threshold), 400), Fault::collision)
          << axis;
      EXPECT_EQ(careful.state().mode, RobotMode::reflex);
      for (int i = 0; i < 300; ++i) careful.miss();
      EXPECT_EQ(careful.state().fault, Fault::collision);
      EXPECT_LT(speed(careful), 1e-3);
      ASSERT_TRUE(careful.recover());
    }
  }
}

TEST_F(ReflexTest, TorqueBeyondTheThresholdOfItsJointIsACollision) {
  ArmModel arm(kUrdf);
  ArmState state;
  arm.update(home(), JointVector::Zero(), state);
  const Wrench F = on_axis(2, 40.0);
  const double on_joint_2 = std::abs((state.J.transpose() * F)[1]);
  for (const double share : {0.9, 1.1}) {
    MujocoRobotOptions options;
    options.collision_torque[1] = on_joint_2 / share;
    MujocoRobot careful(simulation, options);
    careful.place(home(), 0.04);
    EXPECT_EQ(pushed(careful, F, 400), share > 1.0 ? Fault::collision : Fault::none) << share;
  }
}

TEST_F(ReflexTest, RunningIntoTheTableIsACollision) {
  ArmModel arm(kUrdf);
  ArmState state;
  MujocoRobotOptions options;
  options.collision_force.head<3>().setConstant(25.0);
  MujocoRobot careful(simulation, options);
  careful.place(
      arm.solve_ik({Eigen::Vector3d(0.5, 0, 0.03), Eigen::Quaterniond(0, 1, 0, 0)}, home()), 0.0);
  JointVector tau = JointVector::Zero();
  double largest = 0;
  for (int i = 0; i < 2000 && careful.state().fault == Fault::none; ++i) {
    arm.update(careful.state().q, careful.state().dq, state);
    const JointVector wanted =
        state.J.transpose() * on_axis(2, -40.0 - 300 * state.V_WE[2]) - 5 * careful.state().dq;
    tau += (wanted - tau).cwiseMax(-0.9).cwiseMin(0.9);
    careful.write(tau);
    largest = std::max(largest, careful.state().tau_external.cwiseAbs().maxCoeff());
  }
  EXPECT_EQ(careful.state().fault, Fault::collision);
  EXPECT_EQ(careful.state().contact_W[2], 1) << "the table pushes up";
  EXPECT_GT(largest, 5.0);
}

TEST_F(ReflexTest, ToolFasterThanItsLimitIsAFaultThoughNoJointIs) {
  JointVector stretched = home();
  stretched[1] = 0.9, stretched[3] = -0.8, stretched[5] = 2.6;
  robot.place(stretched, 0.04);
  double before = 0.0;
  for (int i = 0; i < 1000 && robot.state().fault == Fault::none; ++i) {
    before = tool_velocity().head<3>().norm();
    const double t = 0.001 * i;
    follow(robot, stretched + on_joint(0, 2.0 * t * t), on_joint(0, 4.0 * t));
  }
  EXPECT_EQ(robot.state().fault, Fault::cartesian_velocity_limit);
  EXPECT_LE(before, 1.7);
  EXPECT_GT(tool_velocity().head<3>().norm(), 1.7);
  EXPECT_LT(robot.state().dq[0], 2.175);
  expect_held(500);
}

TEST_F(ReflexTest, ToolThatTurnsFasterThanItsLimitIsAFaultThoughNoJointIs) {
  double before = 0.0;
  for (int i = 0; i < 1000 && robot.state().fault == Fault::none; ++i) {
    before = tool_velocity().tail<3>().norm();
    robot.write(on_joint(6, std::min(6.0, 0.9 * i)));
  }
  EXPECT_EQ(robot.state().fault, Fault::cartesian_velocity_limit);
  EXPECT_LE(before, 2.5);
  EXPECT_GT(tool_velocity().tail<3>().norm(), 2.5);
  EXPECT_LT(robot.state().dq[6], 2.61);
  expect_held(500);
}

TEST_F(ReflexTest, NoReflexWhileTheRobotIsIdle) {
  simulation.push(on_axis(1, 110.0));
  for (int i = 0; i < 500; ++i) robot.miss();
  EXPECT_EQ(robot.state().fault, Fault::none);
  EXPECT_EQ(robot.state().contact_W[1], 1);
}

}  // namespace
}  // namespace tandem
