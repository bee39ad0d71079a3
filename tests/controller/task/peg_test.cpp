#include "controller/task/peg.h"

#include <gtest/gtest.h>

#include "controller/rig.h"

namespace tandem {
namespace {

using testing::Rig;

TEST(PegTask, SameSeedGivesTheSameSceneAndAnotherSeedAnother) {
  Rig rig;
  rig.begin(11);
  const SceneTruth first = rig.task->truth(rig.simulation);
  rig.begin(12);
  const SceneTruth other = rig.task->truth(rig.simulation);
  rig.begin(11);
  const SceneTruth again = rig.task->truth(rig.simulation);
  EXPECT_EQ(first.X_WO.p, again.X_WO.p);
  EXPECT_EQ(first.X_WG.p, again.X_WG.p);
  EXPECT_NE(first.X_WG.p, other.X_WG.p);
}

TEST(PegTask, ResetsStayWithinTheirDistribution) {
  Rig rig;
  double widest = 0.0;
  for (uint64_t seed = 0; seed < 40; ++seed) {
    rig.begin(seed);
    const SceneTruth truth = rig.task->truth(rig.simulation);
    const Eigen::Vector3d d = truth.X_WG.p - Eigen::Vector3d(0.5, 0.0, 0.04);
    ASSERT_LE(d.head<2>().cwiseAbs().maxCoeff(), 0.040 + 1e-9);
    ASSERT_LE(std::abs(log_map(truth.X_WG.R).z()), 15.0 * M_PI / 180 + 1e-9);
    ASSERT_FALSE(rig.task->succeeded(truth, rig.simulation));
    widest = std::max(widest, d.head<2>().cwiseAbs().maxCoeff());
  }
  EXPECT_GT(widest, 0.03);
}

TEST(PegTask, SuccessNeedsDepthInsideTheHole) {
  Rig rig;
  rig.begin(1);
  SceneTruth truth = rig.task->truth(rig.simulation);
  truth.X_WO = truth.X_WG * Pose{{0.0, 0.0, -0.026}, Eigen::Quaterniond::Identity()};
  EXPECT_TRUE(rig.task->succeeded(truth, rig.simulation));
  truth.X_WO = truth.X_WG * Pose{{0.0, 0.0, -0.020}, Eigen::Quaterniond::Identity()};
  EXPECT_FALSE(rig.task->succeeded(truth, rig.simulation));
  truth.X_WO = truth.X_WG * Pose{{0.01, 0.0, -0.026}, Eigen::Quaterniond::Identity()};
  EXPECT_FALSE(rig.task->succeeded(truth, rig.simulation));
}

TEST(Observation, HidesTheInHandErrorAndRepeatsItself) {
  Rig rig;
  rig.begin(21);
  StepSnapshot snapshot = rig.begin_step();
  const int n = rig.task->observation().size();
  std::vector<float> a(n), b(n);
  rig.task->observation().write(snapshot, a.data());
  snapshot.truth.X_WO.p.x() += 0.005;  // the true tip elsewhere: nothing that the policy may know
  rig.task->observation().write(snapshot, b.data());
  EXPECT_EQ(a, b);
  snapshot.truth.X_WG.p.x() += 0.005;
  rig.task->observation().write(snapshot, b.data());
  EXPECT_NE(a, b);
}

TEST(Observation, FineCopyIsClippedAtItsRange) {
  Rig rig;
  rig.begin(22);
  const StepSnapshot snapshot = rig.begin_step();
  const auto& names = rig.task->observation().names();
  std::vector<float> values(names.size());
  rig.task->observation().write(snapshot, values.data());
  for (size_t i = 0; i < names.size(); ++i) {
    if (names[i].rfind("goal_fine_", 0) == 0) {
      EXPECT_LE(std::abs(values[i]), 1.0f) << names[i];
    }
    if (names[i] == "goal_fine_z") {
      EXPECT_EQ(std::abs(values[i]), 1.0f);  // 5 cm above: out of the fine range
    }
  }
}

}  // namespace
}  // namespace tandem
