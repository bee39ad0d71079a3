#include "controller/safety/safety_filter.h"

#include <gtest/gtest.h>

#include <limits>

#include "controller/law/law_rig.h"
#include "support/allocation_counter.h"

namespace tandem {
namespace {

using namespace testing;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

class Safety : public ::testing::Test {
 protected:
  Safety() { at(home()); }

  void at(const JointVector& q, const JointVector& dq = JointVector::Zero()) {
    model.update(q, dq, arm);
  }
  // Torque after as many ticks as the rate limit can take.
  JointVector settled(const JointVector& requested) {
    JointVector tau = JointVector::Zero();
    for (int i = 0; i < 200; ++i) tau = filter.limit(arm, requested, tau);
    return tau;
  }
  double wild() {
    switch (random.next() % 12) {
      case 0:
        return kNaN;
      case 1:
        return random.next() % 2 ? kInfinity : -kInfinity;
      case 2:
        return random.normal(1e300);
      case 3:
        return 0.0;
      default:
        return random.normal(random.next() % 2 ? 3.0 : 100.0);
    }
  }

  const Eigen::Vector3d low{0.1, -0.4, 0.05}, high{0.6, 0.4, 0.7};
  const SafetySettings settings = default_safety();
  Random random{11};
  ArmModel model{kUrdf};
  SafetyFilter filter{settings, model, low, high};
  ArmState arm;
};

TEST_F(Safety, TorqueIsFiniteInRangeAndInRateWhateverGoesIn) {
  const JointVector limit = SafetyFilter::torque_limit();
  JointVector previous = JointVector::Zero();
  for (int sample = 0; sample < 150'000; ++sample) {
    // Mostly a measurement that could be, sometimes one that could not.
    ArmState state = arm;
    JointVector asked;
    for (int i = 0; i < 7; ++i) {
      state.q[i] = random.uniform(-3.8, 3.8);
      state.dq[i] = random.normal(2.0);
      asked[i] = random.normal(50.0);
    }
    for (int i = 0; i < 3; ++i) state.X_WE.p[i] = random.normal(0.5);
    if (sample % 3 == 0) state.q[random.next() % 7] = wild();
    if (sample % 5 == 0) state.dq[random.next() % 7] = wild();
    if (sample % 7 == 0) state.J(random.next() % 42) = wild();
    if (sample % 11 == 0) state.V_WE[random.next() % 6] = wild();
    if (sample % 13 == 0) state.X_WE.p[random.next() % 3] = wild();
    if (sample % 2 == 0) asked[random.next() % 7] = wild();
    const JointVector tau = filter.limit(state, asked, previous);
    ASSERT_TRUE(tau.allFinite());
    for (int i = 0; i < 7; ++i) {
      ASSERT_LE(std::abs(tau[i]), limit[i]);  // the robot trips above
      ASSERT_LE(std::abs(tau[i] - previous[i]), SafetyFilter::kStep + 1e-12);
    }
    previous = tau;
    if (sample % 1000 == 0) {  // and from the edges of the range
      for (int i = 0; i < 7; ++i) previous[i] = random.next() % 2 ? limit[i] : -limit[i];
    }
  }
  for (const int64_t count : filter.counts()) EXPECT_GT(count, 1000) << "every limit was met";
}

TEST_F(Safety, AwayFromEveryLimitNothingIsChanged) {
  for (int sample = 0; sample < 1000; ++sample) {
    JointVector q = home(), dq, previous, asked;
    for (int i = 0; i < 7; ++i) {
      q[i] += random.uniform(-0.15, 0.15);
      dq[i] = random.uniform(-1.0, 1.0);
      previous[i] = random.uniform(-11.0, 11.0);
      asked[i] = previous[i] + random.uniform(-0.99, 0.99);
    }
    at(q, dq);
    ASSERT_LT((filter.limit(arm, asked, previous) - asked).cwiseAbs().maxCoeff(), 1e-14);
    ASSERT_EQ(filter.acted(), 0u);
  }
}

TEST_F(Safety, PegWorkspaceIsAwayFromTheJointLimits) {
  for (const double x : {0.35, 0.5, 0.65}) {
    for (const double y : {-0.15, 0.15}) {
      for (const double z : {0.05, 0.35}) {
        for (const double yaw : {-0.5, 0.0, 0.5}) {
          const Pose corner{Eigen::Vector3d(x, y, z),
                            exp_map(Eigen::Vector3d(0, 0, yaw)) * Eigen::Quaterniond(0, 1, 0, 0)};
          at(model.solve_ik(corner, home()));
          filter.limit(arm, JointVector::Zero(), JointVector::Zero());
          EXPECT_EQ(filter.acted() & SafetyFilter::joint_position, 0u);
        }
      }
    }
  }
}

TEST_F(Safety, RequestThatIsNotFiniteBecomesDampingAndIsCounted) {
  JointVector dq, asked = JointVector::Zero();
  dq << 0.5, -0.5, 0.5, -0.5, 0.5, -0.5, 0.5;
  at(home(), dq);
  asked[3] = kNaN;
  const JointVector tau = settled(asked);
  for (int i = 0; i < 7; ++i) EXPECT_LT(tau[i] * dq[i], 0.0);
  EXPECT_EQ(filter.acted(), static_cast<uint32_t>(SafetyFilter::not_finite));
  EXPECT_EQ(filter.not_finite_count(), 200);
  arm.q[0] = kNaN;  // nor can a measurement be trusted
  filter.limit(arm, JointVector::Zero(), JointVector::Zero());
  EXPECT_EQ(filter.not_finite_count(), 201);
  arm.dq[0] = kNaN;
  EXPECT_EQ(settled(JointVector::Constant(5.0)), JointVector::Zero());
}

TEST_F(Safety, OneNewtonMetreATickAndNotMore) {
  const JointVector far = SafetyFilter::torque_limit();
  JointVector previous = -far;
  for (int tick = 0; tick < 50; ++tick) {
    const JointVector tau = filter.limit(arm, far, previous);
    EXPECT_LT((tau - previous).maxCoeff(), 1.0);
    previous = tau;
  }
  EXPECT_NE(filter.acted() & SafetyFilter::torque_rate, 0u);
  EXPECT_EQ(settled(10.0 * far), far);
  EXPECT_EQ(filter.acted(), static_cast<uint32_t>(SafetyFilter::torque));
}

TEST_F(Safety, WallPushesBackInEveryDirectionUpToItsLimit) {
  for (int axis = 0; axis < 3; ++axis) {
    for (const double side : {-1.0, 1.0}) {
      const auto force_at = [&](double depth, double speed) -> Eigen::Vector3d {
        at(home());
        arm.X_WE.p = 0.5 * (low + high);
        arm.X_WE.p[axis] = side > 0 ? high[axis] + depth : low[axis] - depth;
        arm.V_WE[axis] = side * speed;
        return external_wrench(arm.J, settled(JointVector::Zero())).head<3>();
      };
      EXPECT_EQ(force_at(-1e-6, 0.5).norm(), 0.0) << "nothing inside";
      const double k = settings.wall_stiffness;
      EXPECT_NEAR(-side * force_at(0.01, 0.0)[axis], 0.01 * k, 0.02 * 0.01 * k);
      EXPECT_GT(-side * force_at(0.005, 0.1)[axis], 1.9 * 0.005 * k) << "harder while it comes";
      EXPECT_NEAR(-side * force_at(0.005, -0.1)[axis], 0.005 * k, 0.2) << "not when it leaves";
      EXPECT_NEAR(-side * force_at(1.0, 0.0)[axis], settings.wall_force_limit, 2.0);
    }
  }
}

TEST_F(Safety, AtAPositionLimitEveryPushTowardsItIsTakenAway) {
  for (int joint = 0; joint < 7; ++joint) {
    for (const double side : {-1.0, 1.0}) {
      JointVector q = home(), push = JointVector::Zero();
      q[joint] = side > 0 ? model.upper_limit()[joint] : model.lower_limit()[joint];
      at(q);
      arm.X_WE.p = 0.5 * (low + high);
      push[joint] = side * 1000.0;
      const double strongest =
          std::min(settings.joint_repulsion, SafetyFilter::torque_limit()[joint]);
      EXPECT_NEAR(-side * settled(push)[joint], strongest, 1e-9);
      EXPECT_EQ(filter.acted() & SafetyFilter::joint_position, 4u);
    }
  }
}

TEST_F(Safety, AtAVelocityLimitEveryJointIsBrakedWhateverIsAsked) {
  for (int joint = 0; joint < 7; ++joint) {
    for (const double side : {-1.0, 1.0}) {
      JointVector dq = JointVector::Zero(), push = JointVector::Zero();
      dq[joint] = side * model.velocity_limit()[joint];
      at(home(), dq);
      push[joint] = side * 1000.0;
      EXPECT_LE(side * settled(push)[joint], -5.0);
      EXPECT_EQ(filter.acted() & SafetyFilter::joint_velocity, 8u);
      push[joint] = -side * 4.0;  // braking that was asked for is left as it is, and added to
      EXPECT_LT(side * settled(push)[joint], -4.0);
    }
  }
}

// A limit that switched on with a step would make the arm buzz at it.
TEST_F(Safety, LimitsBeginWithoutAStep) {
  constexpr double h = 1e-6;
  JointVector asked;
  asked << 10, -10, 10, -10, 5, -5, 5;
  const auto torque = [&](const JointVector& q, const JointVector& dq) {
    at(q, dq);
    arm.X_WE.p = 0.5 * (low + high);
    return settled(asked);
  };
  for (int joint = 0; joint < 7; ++joint) {
    JointVector q = home(), dq = JointVector::Zero(), further;
    q[joint] = model.upper_limit()[joint] - settings.joint_margin;
    dq[joint] = 0.5;
    further = q;
    further[joint] += h;
    EXPECT_LT((torque(q, dq) - torque(further, dq)).norm(), 1e-2);
    dq[joint] = settings.velocity_margin * model.velocity_limit()[joint];
    further = dq;
    further[joint] += h;
    EXPECT_LT((torque(home(), dq) - torque(home(), further)).norm(), 1e-2);
  }
}

TEST_F(Safety, NothingAllocates) {
  JointVector q = model.upper_limit(), dq = model.velocity_limit(), tau = JointVector::Zero();
  at(q, dq);
  const AllocationCounter allocations;
  for (int i = 0; i < 1000; ++i)
    tau = filter.limit(arm, JointVector::Constant(i % 10 ? 50.0 : kNaN), tau);
  EXPECT_EQ(allocations.count(), 0);
}

}  // namespace
}  // namespace tandem
