#include "controller/law/cartesian_impedance.h"

#include <gtest/gtest.h>

#include "controller/law/law_rig.h"
#include "support/allocation_counter.h"

namespace tandem {
namespace {

using namespace testing;

class Law : public ::testing::Test {
 protected:
  Law() { at(home()); }

  void at(const JointVector& q, const JointVector& dq = JointVector::Zero()) {
    model.update(q, dq, arm);
  }

  // What the law's torque is at the tool, exactly: the least squares without damping.
  Wrench at_tool(const JointVector& tau) const {
    const Matrix6 gram = arm.J * arm.J.transpose();
    return gram.ldlt().solve(arm.J * (tau - arm.coriolis));
  }

  // Full matrices, signs that differ, either axes; no posture, which is another task.
  ImpedanceGains random_gains() {
    ImpedanceGains gains = default_gains();
    gains.tool_axes = random.next() % 2;
    gains.stiffness = random_stiffness(random);
    gains.damping = damping_from_ratio(gains.stiffness, gains.apparent_inertia, 1.0);
    for (int i = 0; i < 6; ++i) {
      gains.clip_low[i] = random.uniform(0.0, i < 3 ? 0.02 : 0.2);
      gains.clip_high[i] = random.uniform(0.0, i < 3 ? 0.02 : 0.2);
    }
    gains.posture_stiffness = 0.0;
    return gains;
  }

  PoseReference reference(const Twist& error) const {
    return {add(arm.X_WE, error), Twist::Zero()};
  }

  // The arm's pose with a tool turned at random; the Jacobian is that of the home pose.
  void turn_tool() { arm.X_WE.R = random_rotation(random); }

  static Twist to_base(const ImpedanceGains& gains, const Eigen::Quaterniond& R, const Twist& v) {
    Twist out = v;
    if (gains.tool_axes) out << R * v.head<3>(), R * v.tail<3>();
    return out;
  }

  Random random{5};
  ArmModel model{kUrdf};
  ArmState arm;
};

TEST_F(Law, StaticForceNeverExceedsItsBound) {
  for (int sample = 0; sample < 5000; ++sample) {
    turn_tool();
    CartesianImpedance law(random_gains());
    const Wrench F = at_tool(law.torque(arm, reference(random_twist(random, 0.1, 1.5))));
    const Wrench bound = law.force_bound(arm.X_WE.R);
    for (int i = 0; i < 6; ++i) ASSERT_LE(std::abs(F[i]), bound[i] * (1 + 1e-9) + 1e-9);
  }
}

TEST_F(Law, ForceBoundIsReachedInEveryAxisWithSomeError) {
  for (int sample = 0; sample < 300; ++sample) {
    turn_tool();
    const ImpedanceGains gains = random_gains();
    CartesianImpedance law(gains);
    const Wrench bound = law.force_bound(arm.X_WE.R);
    // Errors beyond every clip, in all 64 combinations of signs.
    Wrench largest = Wrench::Zero();
    for (int signs = 0; signs < 64; ++signs) {
      Twist error;
      for (int i = 0; i < 6; ++i) error[i] = (signs >> i & 1) ? 1.0 : -1.0;
      const Twist in_base = to_base(gains, arm.X_WE.R, error);
      largest = largest.cwiseMax(at_tool(law.torque(arm, reference(in_base))).cwiseAbs());
    }
    ASSERT_LT((largest - bound).cwiseAbs().maxCoeff(), 1e-6 * bound.maxCoeff());
  }
}

TEST_F(Law, DefaultBoundIsTwentyNewtonAndFifteenNewtonMetre) {
  const CartesianImpedance law(default_gains());
  EXPECT_LT((law.force_bound(random_rotation(random)) - six(20.0, 15.0)).norm(), 1e-9);
}

TEST_F(Law, CoupledStiffnessPushesAcrossAxes) {
  ImpedanceGains gains = random_gains();
  gains.tool_axes = false;
  gains.clip_low = gains.clip_high = six(0.1, 0.5);
  CartesianImpedance law(gains);
  for (int j = 0; j < 6; ++j) {
    Twist error = Twist::Zero();
    error[j] = 0.01;
    const Wrench F = at_tool(law.torque(arm, reference(error)));
    EXPECT_LT((F - 0.01 * gains.stiffness.col(j)).norm(), 1e-9);
  }
}

TEST_F(Law, RotationErrorCountsInFullUpToHalfATurn) {
  ImpedanceGains gains = default_gains();
  gains.posture_stiffness = 0.0;
  gains.clip_low = gains.clip_high = six(0.1, 4.0);
  CartesianImpedance law(gains);
  for (int sample = 0; sample < 1000; ++sample) {
    turn_tool();
    Eigen::Vector3d axis(random.normal(1), random.normal(1), random.normal(1));
    axis.normalize();
    const double angle = random.uniform(0, 1) < 0.5 ? 3.14159265 - random.uniform(0.0, 1e-3)
                                                    : random.uniform(0.0, 3.14);
    Twist error = Twist::Zero();
    error.tail<3>() = angle * axis;
    const Wrench F = at_tool(law.torque(arm, reference(error)));
    ASSERT_LT((F.tail<3>() - 150.0 * angle * axis).norm(), 1e-4);
    ASSERT_LT(F.head<3>().norm(), 1e-6);
  }
}

TEST_F(Law, NewGainsAreRampedInAStraightLine) {
  for (int sample = 0; sample < 100; ++sample) {
    turn_tool();
    const ImpedanceGains before = random_gains(), after = random_gains();
    const PoseReference wanted = reference(random_twist(random, 0.05, 0.5));
    CartesianImpedance law(before), fresh(after);
    const JointVector start = law.torque(arm, wanted), end = fresh.torque(arm, wanted);
    law.set_gains(after);
    JointVector last = start;
    for (int tick = 1; tick <= CartesianImpedance::kRampTicks; ++tick) {
      const JointVector tau = law.torque(arm, wanted);
      ASSERT_LT((tau - last - (end - start) / CartesianImpedance::kRampTicks).norm(), 1e-9);
      ASSERT_LT((tau - last).cwiseAbs().maxCoeff(), 1.0);  // N m: where the robot trips
      last = tau;
    }
    EXPECT_LT((last - end).norm(), 1e-9);
    EXPECT_FALSE(law.ramping());
  }
}

TEST_F(Law, StiffnessStaysPositiveInEveryRamp) {
  for (int sample = 0; sample < 20; ++sample) {
    turn_tool();
    CartesianImpedance law(random_gains());
    law.set_gains(random_gains());
    for (int tick = 0; tick < CartesianImpedance::kRampTicks; ++tick) {
      CartesianImpedance here = law;
      law.torque(arm, reference(Twist::Zero()));
      if (tick % 20) continue;
      // Stiffness by differences too small for the clip; each probe is the same tick of the ramp.
      Matrix6 K;
      for (int j = 0; j < 6; ++j) {
        CartesianImpedance probe = here;
        Twist error = Twist::Zero();
        error[j] = 1e-6;
        K.col(j) = at_tool(probe.torque(arm, reference(error))) / 1e-6;
      }
      ASSERT_LT((K - K.transpose()).norm(), 1e-4 * K.norm());
      ASSERT_GT(Eigen::SelfAdjointEigenSolver<Matrix6>(K).eigenvalues().minCoeff(), 0.0);
    }
  }
}

TEST_F(Law, ForceBoundHoldsDuringRampAndFade) {
  CartesianImpedance law(random_gains());
  for (int tick = 0; tick < 5000; ++tick) {
    if (random.uniform(0, 1) < 0.01) law.set_gains(random_gains());
    if (random.uniform(0, 1) < 0.005) law.set_damped(random.next() % 2);
    const Wrench F = at_tool(law.torque(arm, reference(random_twist(random, 0.1, 1.5))));
    const Wrench bound = law.force_bound(arm.X_WE.R);
    for (int i = 0; i < 6; ++i) ASSERT_LE(std::abs(F[i]), bound[i] * (1 + 1e-9) + 1e-9);
  }
}

TEST_F(Law, OfGainsThatComeDuringARampTheLatestIsTakenAfterIt) {
  const ImpedanceGains first = random_gains(), skipped = random_gains(), last = random_gains();
  const PoseReference wanted = reference(Twist::Zero());
  CartesianImpedance law(default_gains());
  law.set_gains(first);
  law.torque(arm, wanted);
  law.set_gains(skipped);
  law.set_gains(last);
  for (int i = 1; i < CartesianImpedance::kRampTicks; ++i) law.torque(arm, wanted);
  EXPECT_EQ(law.gains().stiffness, first.stiffness);
  for (int i = 0; i <= CartesianImpedance::kRampTicks; ++i) law.torque(arm, wanted);
  EXPECT_EQ(law.gains().stiffness, last.stiffness);
  EXPECT_FALSE(law.ramping());
}

TEST_F(Law, ResetTakesTheLatestGainsAtOnce) {
  const ImpedanceGains waiting = random_gains();
  CartesianImpedance law(default_gains()), fresh(waiting);
  law.set_gains(random_gains());
  law.set_gains(waiting);
  law.set_damped(true);
  law.torque(arm, reference(Twist::Zero()));
  law.reset();
  const PoseReference wanted = reference(random_twist(random, 0.05, 0.5));
  EXPECT_EQ(law.torque(arm, wanted), fresh.torque(arm, wanted));
  EXPECT_EQ(law.stiffness_share(), 1.0);
}

TEST_F(Law, DampedArmFeelsNoSpringAndGetsItBackWithoutAJump) {
  ImpedanceGains gains = default_gains();
  CartesianImpedance law(gains);
  JointVector q = home(), dq;
  q[0] += 0.3;  // away from the posture, too
  for (int i = 0; i < 7; ++i) dq[i] = random.uniform(-0.1, 0.1);
  at(q, dq);
  PoseReference wanted = reference(Twist::Constant(1.0));
  wanted.V_WE = six(0.05, 0.2);
  const JointVector stiff = law.torque(arm, wanted);
  law.set_damped(true);
  JointVector last = stiff;
  for (int i = 0; i < CartesianImpedance::kFadeTicks; ++i) {
    const JointVector tau = law.torque(arm, wanted);
    ASSERT_LT((tau - last).cwiseAbs().maxCoeff(), 0.2);
    last = tau;
  }
  EXPECT_EQ(law.force_bound(arm.X_WE.R), Wrench::Zero());
  EXPECT_LT(arm.dq.dot(last - arm.coriolis), 0.0) << "what is left takes energy out";
  PoseReference elsewhere = reference(Twist::Constant(-1.0));
  EXPECT_LT((law.torque(arm, elsewhere) - last).norm(), 1e-12) << "the reference plays no part";
  law.set_damped(false);
  for (int i = 0; i < CartesianImpedance::kFadeTicks; ++i) {
    const JointVector tau = law.torque(arm, wanted);
    ASSERT_LT((tau - last).cwiseAbs().maxCoeff(), 0.2);
    last = tau;
  }
  EXPECT_LT((last - stiff).norm(), 1e-9);
}

TEST_F(Law, CommandedPoseNeverLeadsByMoreThanTheClip) {
  for (int sample = 0; sample < 2000; ++sample) {
    turn_tool();
    const ImpedanceGains gains = random_gains();
    const CartesianImpedance law(gains);
    const Eigen::Quaterniond R = arm.X_WE.R, back = R.conjugate();
    const Twist lead = random_twist(random, 0.03, 0.3), increment = random_twist(random, 0.01, 0.1);
    const Twist allowed = law.allowed(increment, lead, R);
    const Twist a = to_base(gains, back, allowed), s = to_base(gains, back, increment),
                l = to_base(gains, back, lead);
    for (int i = 0; i < 6; ++i) {
      ASSERT_GE(a[i] * s[i], -1e-15) << "never turns an increment around";
      ASSERT_LE(std::abs(a[i]), std::abs(s[i]) + 1e-15);
      if (std::abs(a[i]) > 1e-12) {
        ASSERT_LE(l[i] + a[i], std::max(gains.clip_high[i], l[i]) + 1e-12);
        ASSERT_GE(l[i] + a[i], std::min(-gains.clip_low[i], l[i]) - 1e-12);
      }
    }
    // Small leads are no reason to cut.
    const Twist small = 1e-9 * increment;
    const bool room = (gains.clip_low.minCoeff() > 1e-8) && (gains.clip_high.minCoeff() > 1e-8);
    ASSERT_TRUE(!room || (law.allowed(small, Twist::Zero(), R) - small).norm() < 1e-20);
  }
}

TEST_F(Law, PostureTaskHardlyTouchesTheTool) {
  CartesianImpedance law(default_gains());
  for (int sample = 0; sample < 200; ++sample) {
    JointVector q = home();
    for (int i = 0; i < 7; ++i) q[i] += random.uniform(-0.3, 0.3);
    at(q);
    const Wrench F = at_tool(law.torque(arm, reference(Twist::Zero())));
    ASSERT_LT(F.head<3>().norm(), 0.5);  // N
    ASSERT_LT(F.tail<3>().norm(), 0.5);  // N m
  }
}

TEST_F(Law, SingularityDampsTheJointsAndNothingElseDoes) {
  ImpedanceGains gains = default_gains();
  gains.posture_stiffness = 0.0;
  CartesianImpedance law(gains);
  const auto extra = [&](const JointVector& q, const JointVector& dq) -> JointVector {
    at(q, dq);
    const JointVector plain = arm.J.transpose() * (-gains.damping * arm.V_WE) + arm.coriolis;
    return law.torque(arm, reference(Twist::Zero())) - plain;
  };
  const JointVector dq = JointVector::Constant(0.5);
  EXPECT_LT(extra(home(), dq).norm(), 1e-12);
  for (const double x : {0.35, 0.5, 0.65}) {
    for (const double y : {-0.15, 0.0, 0.15}) {
      for (const double z : {0.05, 0.2, 0.35}) {
        const Pose corner{Eigen::Vector3d(x, y, z), Eigen::Quaterniond(0, 1, 0, 0)};
        EXPECT_LT(extra(model.solve_ik(corner, home()), dq).norm(), 1e-12) << "peg workspace";
      }
    }
  }
  JointVector stretched;
  stretched << 0.0, 1.2, 0.0, -0.3, 0.0, 1.2, 0.785;
  const JointVector damping = extra(stretched, dq);
  EXPECT_GT(-damping[0] / dq[0], 2.0);  // N m s/rad
  EXPECT_LT((damping - damping[0] / dq[0] * dq).norm(), 1e-9);
}

TEST_F(Law, ExternalWrenchIsFoundFromTheJointTorques) {
  for (int sample = 0; sample < 100; ++sample) {
    const Wrench F = random_twist(random, 30.0, 5.0);
    EXPECT_LT((external_wrench(arm.J, arm.J.transpose() * F) - F).norm(), 0.02 * F.norm());
  }
}

TEST_F(Law, NothingAllocates) {
  const ImpedanceGains other = random_gains();
  CartesianImpedance law(default_gains());
  const PoseReference wanted = reference(Twist::Constant(0.01));
  const AllocationCounter allocations;
  for (int tick = 0; tick < 2000; ++tick) {
    if (tick % 300 == 0) law.set_gains(other);
    law.set_damped(tick % 700 > 350);
    law.torque(arm, wanted);
    law.force_bound(arm.X_WE.R);
    law.allowed(Twist::Constant(1e-4), Twist::Zero(), arm.X_WE.R);
  }
  EXPECT_EQ(allocations.count(), 0);
}

}  // namespace
}  // namespace tandem
