#include "controller/law/arm_model.h"

#include <gtest/gtest.h>

#include <fstream>
#include <random>

#include "controller/robot/scenes.h"
#include "support/allocation_counter.h"

namespace tandem {
namespace {

using namespace testing;

class ArmModelTest : public ::testing::Test {
 protected:
  JointVector random_vector(const JointVector& low, const JointVector& high) {
    JointVector v;
    for (int i = 0; i < 7; ++i) v[i] = std::uniform_real_distribution<>(low[i], high[i])(random);
    return v;
  }
  JointVector random_q() { return random_vector(arm.lower_limit(), arm.upper_limit()); }
  JointVector random_dq() { return random_vector(-arm.velocity_limit(), arm.velocity_limit()); }
  template <typename Call>
  static std::string refusal(const Call& call) {
    try {
      call();
    } catch (const std::exception& error) {
      return error.what();
    }
    return "accepted";
  }

  std::mt19937_64 random{3};
  ArmModel arm{kUrdf};
  ArmState state;
};

TEST_F(ArmModelTest, PoseAtHomeIsWhereTheDataSheetPutsIt) {
  arm.update(JointVector::Zero(), JointVector::Zero(), state);
  EXPECT_LT(
      (state.X_WE.p - Eigen::Vector3d(0.088, 0, 0.333 + 0.316 + 0.384 - 0.107 - 0.1034)).norm(),
      1e-12);
  EXPECT_GE(state.X_WE.R.w(), 0.0);
  arm.update(home(), JointVector::Zero(), state);
  EXPECT_LT(log_map(state.X_WE.R * Eigen::Quaterniond(0, 1, 0, 0).conjugate()).norm(), 1e-12)
      << "tool points straight down";
}

TEST_F(ArmModelTest, JacobianIsTheDerivativeOfThePose) {
  constexpr double h = 1e-6;
  for (int sample = 0; sample < 20; ++sample) {
    const JointVector q = random_q(), dq = random_dq();
    arm.update(q, dq, state);
    ArmState ahead, behind;
    for (int i = 0; i < 7; ++i) {
      JointVector d = JointVector::Zero();
      d[i] = h;
      arm.update(q + d, dq, ahead);
      arm.update(q - d, dq, behind);
      EXPECT_LT((minus(ahead.X_WE, behind.X_WE) / (2 * h) - state.J.col(i)).norm(), 1e-8);
    }
    EXPECT_LT((state.V_WE - state.J * dq).norm(), 1e-14);
  }
}

TEST_F(ArmModelTest, CoriolisPowerIsHalfTheRateOfTheMassMatrix) {
  constexpr double h = 1e-6;
  for (int sample = 0; sample < 20; ++sample) {
    const JointVector q = random_q(), dq = random_dq();
    arm.update(q, dq, state);
    const JointMatrix rate = (arm.mass(q + h * dq) - arm.mass(q - h * dq)) / (2 * h);
    EXPECT_NEAR(dq.dot(state.coriolis), 0.5 * dq.dot(rate * dq), 1e-6);
  }
}

TEST_F(ArmModelTest, InverseKinematicsComesBackToThePoseFromNearAndFar) {
  for (int sample = 0; sample < 50; ++sample) {
    const JointVector goal = 0.8 * (random_q() - home()) + home();
    arm.update(goal, JointVector::Zero(), state);
    const Pose wanted = state.X_WE;
    const JointVector near = arm.solve_ik(wanted, goal + 0.1 * JointVector::Random());
    arm.update(near, JointVector::Zero(), state);
    EXPECT_LT(minus(wanted, state.X_WE).norm(), 1e-9);
    EXPECT_TRUE((near.array() >= arm.lower_limit().array()).all() &&
                (near.array() <= arm.upper_limit().array()).all());
  }
  for (const double x : {0.35, 0.5, 0.65}) {
    for (const double y : {-0.2, 0.0, 0.2}) {
      const Pose wanted{Eigen::Vector3d(x, y, 0.1), Eigen::Quaterniond(0, 1, 0, 0)};
      arm.update(arm.solve_ik(wanted, home()), JointVector::Zero(), state);
      EXPECT_LT(minus(wanted, state.X_WE).norm(), 1e-9);
    }
  }
}

TEST_F(ArmModelTest, PoseOutOfReachIsRefusedWithASentence) {
  const std::string text = refusal([&] {
    arm.solve_ik({Eigen::Vector3d(2, 0, 0), Eigen::Quaterniond(0, 1, 0, 0)}, home());
  });
  EXPECT_NE(text.find("p = (2.0000, 0.0000, 0.0000) m"), std::string::npos) << text;
  EXPECT_NE(text.find("mm and"), std::string::npos) << text;
}

TEST_F(ArmModelTest, LoadWeighsOnTheArmAndCanBeTakenAway) {
  const JointVector q = home();
  const JointVector bare = arm.gravity(q);
  Load load;
  load.mass = 0.5;
  load.com_E = Eigen::Vector3d(0, 0, 0.05);
  load.inertia_E = 1e-3 * Eigen::Matrix3d::Identity();
  arm.set_load(load);
  arm.update(q, JointVector::Zero(), state);
  const Eigen::Vector3d r =
      state.X_WE.R * load.com_E;  // force at the centre of mass = force at E and moment r x f
  const Eigen::Vector3d f(0, 0, 0.5 * 9.81);
  Wrench hold;
  hold << f, r.cross(f);
  EXPECT_LT((arm.gravity(q) - bare - state.J.transpose() * hold).norm(), 1e-12);
  arm.set_load(Load{});
  EXPECT_LT((arm.gravity(q) - bare).norm(), 1e-15);
  load.mass = -1;
  EXPECT_THROW(arm.set_load(load), std::invalid_argument);
}

TEST_F(ArmModelTest, LimitsAreThoseOfTheUrdf) {
  EXPECT_EQ(arm.upper_limit()[3], -0.0698);
  EXPECT_EQ(arm.velocity_limit()[6], 2.61);
  EXPECT_EQ(arm.torque_limit()[0], 87.0);
}

TEST_F(ArmModelTest, NothingAllocatesInTheLoop) {
  const JointVector q = home(), dq = random_dq();
  AllocationCounter allocations;
  for (int i = 0; i < 10; ++i) arm.update(q, dq, state);
  const JointMatrix M = arm.mass(q);
  const JointVector g = arm.gravity(q);
  EXPECT_EQ(allocations.count(), 0);
  EXPECT_TRUE(M.allFinite() && g.allFinite());
}

TEST_F(ArmModelTest, FilesThatAreNoArmAreRefusedWithASentence) {
  EXPECT_EQ(refusal([] { ArmModel missing("no/such/arm.urdf"); }),
            "no/such/arm.urdf: the URDF of the arm cannot be opened.");
  const std::string path = ::testing::TempDir() + "two_links.urdf";
  std::ofstream(path) << R"(<robot name="r"><link name="a"/><link name="b"/>
    <joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint></robot>)";
  EXPECT_NE(refusal([&] { ArmModel wrong(path); }).find("to link `tool`"), std::string::npos);
}

}  // namespace
}  // namespace tandem
