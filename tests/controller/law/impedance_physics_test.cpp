// The law on a simulated arm: what is promised on paper, measured by pushing.
#include <gtest/gtest.h>

#include "controller/law/law_rig.h"

namespace tandem {
namespace {

using namespace testing;

// Null space at rest where the arm stands, so that only the spring of the tool is measured.
ImpedanceGains without_posture(ImpedanceGains gains = default_gains()) {
  gains.posture_stiffness = 0.0;
  return gains;
}

// How far the tool gives way, in base axes, when it is pushed with F.
Twist displacement(LawRig& rig, const Wrench& F) {
  rig.place(home());
  for (int tick = 0; tick < 3000; ++tick) {
    rig.push(F);
    rig.tick();
  }
  EXPECT_LT(rig.arm.dq.norm(), 1e-3) << "at rest";
  return minus(rig.arm.X_WE, rig.reference.X_WE);
}

TEST(Impedance, StaticStiffnessIsTheOneThatWasAskedFor) {
  LawRig rig(default_gains());
  const Twist push = six(12.0, 5.0), k = rig.law.gains().stiffness.diagonal();
  for (int i = 0; i < 6; ++i) {
    for (const double side : {-1.0, 1.0}) {
      Wrench F = Wrench::Zero();
      F[i] = side * push[i];
      const Twist d = displacement(rig, F);
      EXPECT_NEAR(F[i] / d[i], k[i], 0.03 * k[i]) << "axis " << i;
      RecordProperty("stiffness_" + std::to_string(i), std::to_string(F[i] / d[i]));
      for (int j = 0; j < 6; ++j) {
        EXPECT_TRUE(j == i || std::abs(k[j] * d[j]) < 0.05 * push[j]) << "axis " << j;
      }
    }
  }
}

TEST(Impedance, FullMatrixInEitherAxesIsTheStiffnessOfTheArm) {
  Random random{21};
  for (int sample = 0; sample < 6; ++sample) {
    ImpedanceGains gains = without_posture();
    gains.tool_axes = sample % 2;
    gains.stiffness = random_stiffness(random);
    gains.damping = damping_from_ratio(gains.stiffness, gains.apparent_inertia, 1.0);
    gains.clip_low = gains.clip_high = six(0.1, 0.5);
    LawRig rig(gains);
    const Wrench F = random_twist(random, 6.0, 1.0);
    const Twist d = displacement(rig, F);
    Matrix6 turn = Matrix6::Identity();  // the tool's axes turn with it
    if (gains.tool_axes) {
      turn.topLeftCorner<3, 3>() = rig.arm.X_WE.R.toRotationMatrix();
      turn.bottomRightCorner<3, 3>() = turn.topLeftCorner<3, 3>();
    }
    const Twist expected = turn * gains.stiffness.ldlt().solve(turn.transpose() * F);
    EXPECT_LT((d - expected).head<3>().norm(), 0.03 * expected.head<3>().norm() + 5e-5);
    EXPECT_LT((d - expected).tail<3>().norm(), 0.03 * expected.tail<3>().norm() + 5e-4);
  }
}

// The peg over the block beside the hole; the reference goes into the block, sideways and tilted.
class Contact : public ::testing::Test {
 protected:
  // Mean wrench of the contact over half a second, after two seconds in which all came to rest.
  static Wrench pressed(const ImpedanceGains& gains, const Twist& into) {
    LawRig rig(gains, kPegScene);
    rig.place(rig.model.solve_ik(tool_over({0.5, 0.06, 0.042}), home()));
    const Pose above = rig.reference.X_WE;
    Wrench sum = Wrench::Zero();
    constexpr int kApproach = 500, kRest = 2000, kMean = 500;
    for (int tick = 0; tick < kApproach + kRest + kMean; ++tick) {
      rig.reference.X_WE = add(above, std::min(1.0, tick / double(kApproach)) * into);
      rig.tick();
      if (tick >= kApproach + kRest) sum += rig.simulation.contact_wrench();
    }
    return sum / kMean;
  }
};

TEST_F(Contact, ForceIsTheBoundWhenPressedDeepAndNeverMore) {
  Twist deep = Twist::Zero();
  deep[2] = -0.05;
  const Wrench F = pressed(default_gains(), deep);
  EXPECT_NEAR(F[2], 20.0, 0.6);
  RecordProperty("force_z", std::to_string(F[2]));
  ImpedanceGains gentle = default_gains();
  gentle.clip_low[2] = 0.003;
  EXPECT_NEAR(pressed(gentle, deep)[2], 6.0, 0.6) << "the clip's own sign";
  gentle.clip_low[2] = 0.010;
  gentle.clip_high[2] = 0.003;
  EXPECT_NEAR(pressed(gentle, deep)[2], 20.0, 0.6) << "the other sign plays no part";
}

TEST_F(Contact, NoComponentExceedsTheBoundHoweverItIsPressed) {
  Random random{31};
  for (int sample = 0; sample < 12; ++sample) {
    ImpedanceGains gains = without_posture();
    gains.tool_axes = sample % 2;
    for (int i = 0; i < 6; ++i) {
      gains.clip_low[i] = random.uniform(0.2, 1.0) * (i < 3 ? 0.01 : 0.05);
      gains.clip_high[i] = random.uniform(0.2, 1.0) * (i < 3 ? 0.01 : 0.05);
    }
    Twist into = random_twist(random, 0.02, 0.2);
    into[2] = -random.uniform(0.01, 0.08);
    const Wrench F = pressed(gains, into);
    const Wrench bound = CartesianImpedance(gains).force_bound(tool_over({0, 0, 0}).R);
    EXPECT_GT(F[2], 1.0) << "it does press";
    // The tool is tilted by up to 0.2 rad while the bound is that of the upright one.
    const double slack = gains.tool_axes ? 0.2 * bound.head<3>().norm() : 0.0;
    for (int i = 0; i < 3; ++i) EXPECT_LE(std::abs(F[i]), 1.03 * bound[i] + slack + 0.1);
  }
}

TEST_F(Contact, DampedArmLetsGoOfTheWallAndNewGainsPressWithTheirOwnForce) {
  LawRig rig(default_gains(), kPegScene);
  rig.place(rig.model.solve_ik(tool_over({0.5, 0.06, 0.042}), home()));
  rig.reference.X_WE.p[2] -= 0.05;
  double largest = 0.0;  // change of the law's torque in a tick, before any filter
  const auto run = [&](int ticks) {
    for (int tick = 0; tick < ticks; ++tick) {
      const JointVector before = rig.requested;
      rig.tick();
      largest = std::max(largest, (rig.requested - before).cwiseAbs().maxCoeff());
    }
    return rig.simulation.contact_wrench()[2];
  };
  EXPECT_NEAR(run(2000), 20.0, 0.6);
  largest = 0.0;
  rig.law.set_damped(true);
  EXPECT_LT(run(2000), 0.1);
  rig.law.set_damped(false);
  EXPECT_NEAR(run(2000), 20.0, 0.6);
  ImpedanceGains soft = default_gains();
  soft.stiffness.topLeftCorner<3, 3>() *= 0.5;
  rig.law.set_gains(soft);
  EXPECT_NEAR(run(2000), 10.0, 0.6);
  EXPECT_LT(largest, 1.0) << "N m in a tick";
}

// Largest energy of each second, J.
template <typename Energy>
std::vector<double> peaks(LawRig& rig, int seconds, const Energy& energy) {
  std::vector<double> out;
  for (int second = 0; second < seconds; ++second) {
    double peak = 0.0;
    for (int tick = 0; tick < 1000; ++tick) {
      rig.tick();
      peak = std::max(peak, energy());
    }
    out.push_back(peak);
  }
  return out;
}

void expect_falling(const std::vector<double>& peak) {
  for (size_t i = 1; i < peak.size(); ++i) EXPECT_LE(peak[i], 1.001 * peak[i - 1] + 1e-7) << i;
}

TEST(Energy, DoesNotGrowInFreeMotion) {
  for (const double ratio : {0.05, 1.0}) {
    ImpedanceGains gains = without_posture();
    gains.damping = damping_from_ratio(gains.stiffness, gains.apparent_inertia, ratio);
    LawRig rig(gains);
    Twist away = six(0.008, 0.05);
    away[1] = -0.05;  // beyond the clip
    rig.reference.X_WE = add(rig.reference.X_WE, away);
    const std::vector<double> peak =
        peaks(rig, 60, [&] { return rig.kinetic_energy() + rig.spring_energy(); });
    expect_falling(peak);
    EXPECT_GT(peak.front(), 0.1);
    EXPECT_LT(peak.back(), 1e-6);
  }
}

// Posture and tool together, from a random start: the whole law, motion alone.
TEST(Energy, WholeLawComesToRestAndStaysThere) {
  Random random{41};
  LawRig rig;
  JointVector q = home();
  for (int i = 0; i < 7; ++i) q[i] += random.uniform(-0.2, 0.2);
  rig.place(q);
  rig.reference.X_WE = add(rig.reference.X_WE, six(0.01, 0.08));
  const std::vector<double> peak = peaks(rig, 60, [&] { return rig.kinetic_energy(); });
  EXPECT_GT(peak.front(), 1e-4);
  for (int second = 20; second < 60; ++second) EXPECT_LT(peak[second], 1e-8);
}

TEST(Energy, DoesNotGrowInContactWithAWall) {
  for (const double ratio : {0.2, 1.0}) {
    ImpedanceGains gains = without_posture();
    gains.damping = damping_from_ratio(gains.stiffness, gains.apparent_inertia, ratio);
    LawRig rig(gains, kPegScene);
    rig.place(rig.model.solve_ik(tool_over({0.5, 0.06, 0.055}), home()));  // 15 mm over the block
    Twist into = Twist::Zero();
    into[0] = 0.005;
    into[2] = -0.030;
    rig.reference.X_WE = add(rig.reference.X_WE, into);
    const std::vector<double> peak =
        peaks(rig, 60, [&] { return rig.kinetic_energy() + rig.spring_energy(); });
    expect_falling(peak);
    EXPECT_GT(rig.simulation.contact_wrench()[2], 15.0);
    EXPECT_LT(rig.kinetic_energy(), 1e-7) << "no chatter";
  }
}

TEST(Singularity, ArmPulledStraightStaysSlowAndComesBack) {
  Random random{51};
  double fastest = 0.0;
  for (int sample = 0; sample < 8; ++sample) {
    LawRig rig;
    JointVector q;
    q << random.uniform(-1, 1), random.uniform(0.6, 1.0), 0.0, random.uniform(-0.8, -0.4), 0.0,
        random.uniform(1.2, 2.0), random.uniform(-1, 1);
    rig.place(q);
    const Pose start = rig.reference.X_WE;
    const Eigen::Vector3d shoulder(0, 0, 0.333);
    const Eigen::Vector3d outwards = (start.p - shoulder).normalized();
    // Out of reach, to and fro across the stretched pose, and home.
    for (int tick = 0; tick < 8000; ++tick) {
      const double out = tick < 6000 ? 0.25 * (1.0 - std::cos(tick * 0.001 * 3.1416)) : 0.0;
      rig.reference.X_WE.p = start.p + out * outwards;
      rig.tick();
      ASSERT_LT((rig.arm.dq.cwiseAbs() - rig.model.velocity_limit()).maxCoeff(), -0.5);
      fastest = std::max(fastest, rig.arm.dq.cwiseAbs().maxCoeff());
    }
    EXPECT_LT(rig.arm.dq.norm(), 0.05);
    EXPECT_LT(minus(rig.arm.X_WE, start).head<3>().norm(), 0.01);
  }
  EXPECT_LT(fastest, 0.8) << "1.5 rad/s without the damping";
  RecordProperty("fastest_joint", std::to_string(fastest));
}

}  // namespace
}  // namespace tandem
