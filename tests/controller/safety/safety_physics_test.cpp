// The safety filter around a simulated arm that somebody drives where it must not go.
#include <gtest/gtest.h>

#include "controller/law/law_rig.h"

namespace tandem {
namespace {

using namespace testing;

class SafeArm : public ::testing::Test {
 protected:
  // Of the seven joints, the least distance to a position limit (rad) and to a velocity limit
  // (rad/s); negative beyond.
  static double position_room(const LawRig& rig) {
    return (rig.arm.q - rig.model.lower_limit())
        .cwiseMin(rig.model.upper_limit() - rig.arm.q)
        .minCoeff();
  }
  static double velocity_room(const LawRig& rig) {
    return (rig.model.velocity_limit() - rig.arm.dq.cwiseAbs()).minCoeff();
  }
};

TEST_F(SafeArm, PolicyThatNeverStopsPushingMeetsNoJointLimit) {
  Random random{61};
  int held = 0;
  for (int sample = 0; sample < 12; ++sample) {
    LawRig rig;
    const int64_t before = rig.filter.counts()[2];
    // The commanded pose leads by the clip, for five seconds, in one direction after another.
    Twist direction;
    for (int tick = 0; tick < 5000; ++tick) {
      if (tick % 2500 == 0)
        for (int i = 0; i < 6; ++i) direction[i] = random.next() % 2 ? 1.0 : -1.0;
      rig.reference.X_WE = add(rig.arm.X_WE, direction.cwiseProduct(six(0.01, 0.1)));
      rig.tick();
      ASSERT_GT(position_room(rig), 0.0);
      ASSERT_GT(velocity_room(rig), 0.0);
    }
    held += rig.filter.counts()[2] > before;
  }
  EXPECT_GT(held, 4) << "limits were met";
}

TEST_F(SafeArm, JointThatIsPushedStopsBeforeItsLimit) {
  for (int joint = 0; joint < 7; ++joint) {
    for (const double side : {-1.0, 1.0}) {
      LawRig rig;
      rig.simulation.model()->opt.disableflags |= mjDSBL_CONTACT;  // the table is no help
      JointVector q = home();
      const double limit =
          side > 0 ? rig.model.upper_limit()[joint] : rig.model.lower_limit()[joint];
      q[joint] = limit - side * 0.6;
      rig.place(q);
      // As hard as the law's 20 N and 15 N m can push any joint; the others are held.
      for (int tick = 0; tick < 3000; ++tick) {
        JointVector request = 300.0 * (q - rig.arm.q) - 30.0 * rig.arm.dq;
        request[joint] = side * (joint < 4 ? 30.0 : 12.0);
        rig.apply(request);
        ASSERT_GT(side * (limit - rig.arm.q[joint]), 0.0) << "joint " << joint + 1;
      }
      EXPECT_LT(side * (limit - rig.arm.q[joint]), default_safety().joint_margin);
      EXPECT_LT(std::abs(rig.arm.dq[joint]), 0.05) << "and rests there";
    }
  }
}

TEST_F(SafeArm, NoJointReachesItsVelocityLimit) {
  for (int joint = 0; joint < 7; ++joint) {
    for (const double side : {-1.0, 1.0}) {
      LawRig rig;
      JointVector q = home();
      q[joint] -= side * 0.5;
      rig.place(q);
      double fastest = 0.0;
      for (int tick = 0; tick < 1000; ++tick) {
        JointVector request = 300.0 * (q - rig.arm.q) - 30.0 * rig.arm.dq;
        request[joint] = side * (joint < 4 ? 30.0 : 12.0);
        rig.apply(request);
        fastest = std::max(fastest, std::abs(rig.arm.dq[joint]));
        ASSERT_GT(velocity_room(rig), 0.0) << "joint " << joint + 1;
      }
      EXPECT_GT(fastest, 0.5);
    }
  }
}

TEST_F(SafeArm, WallHoldsAgainstALawThatPullsThroughIt) {
  const Eigen::Vector3d low(0.40, -0.10, 0.30), high(0.55, 0.10, 0.50);
  const SafetySettings settings = default_safety();
  for (int axis = 0; axis < 3; ++axis) {
    for (const double side : {-1.0, 1.0}) {
      LawRig rig(default_gains(), kArmScene, low, high);
      const Eigen::Vector3d centre = 0.5 * (low + high);
      rig.place(rig.model.solve_ik({centre, Eigen::Quaterniond(0, 1, 0, 0)}, home()));
      double deepest = 0.0;
      for (int tick = 0; tick < 6000; ++tick) {
        rig.reference.X_WE.p[axis] = centre[axis] + side * std::min(0.3, tick * 1e-4);
        rig.reference.V_WE[axis] = tick < 3000 ? side * 0.1 : 0.0;
        rig.tick();
        const double beyond =
            side > 0 ? rig.arm.X_WE.p[axis] - high[axis] : low[axis] - rig.arm.X_WE.p[axis];
        deepest = std::max(deepest, beyond);
      }
      // 20 N of the law's spring against 2000 N/m; while it moves, its feed-forward on top.
      const double rest =
          side > 0 ? rig.arm.X_WE.p[axis] - high[axis] : low[axis] - rig.arm.X_WE.p[axis];
      EXPECT_NEAR(rest, 20.0 / settings.wall_stiffness, 1e-3);
      EXPECT_LT(deepest, 0.025);
      EXPECT_LT(rig.arm.dq.norm(), 1e-2) << "no buzzing at the wall";
    }
  }
}

TEST_F(SafeArm, BadRequestsLeaveTheArmAtRestAndInRange) {
  Random random{71};
  LawRig rig;
  JointVector previous = rig.tau;
  for (int tick = 0; tick < 4000; ++tick) {
    JointVector request;
    for (int i = 0; i < 7; ++i) request[i] = random.normal(40.0);
    if (tick % 3 == 0 || tick > 2000) request[random.next() % 7] = std::nan("");
    rig.apply(request);
    ASSERT_LT((rig.tau - previous).cwiseAbs().maxCoeff(), 1.0);
    ASSERT_GT(velocity_room(rig), 0.0);
    previous = rig.tau;
  }
  EXPECT_LT(rig.arm.dq.norm(), 0.05) << "two seconds of damping";
}

}  // namespace
}  // namespace tandem
