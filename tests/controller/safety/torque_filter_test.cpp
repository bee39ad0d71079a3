#include "controller/safety/torque_filter.h"

#include <gtest/gtest.h>

#include <limits>

#include "base/random.h"

namespace tandem {
namespace {

TEST(TorqueFilter, StaysWithinTorqueAndRateWhateverIsAsked) {
  TorqueFilter filter;
  Random random{3};
  JointVector previous = JointVector::Zero();
  const JointVector limit = TorqueFilter::torque_limit();
  for (int tick = 0; tick < 20'000; ++tick) {
    JointVector asked;
    for (int j = 0; j < 7; ++j) {
      const double u = random.uniform(0, 1);
      asked[j] = u < 0.01   ? std::numeric_limits<double>::quiet_NaN()
                 : u < 0.02 ? std::numeric_limits<double>::infinity()
                            : random.normal(200.0);
    }
    const JointVector tau = filter.limit(asked, previous);
    ASSERT_TRUE(tau.allFinite());
    for (int j = 0; j < 7; ++j) {
      ASSERT_LE(std::abs(tau[j]), limit[j] + 1e-9);
      ASSERT_LT(std::abs(tau[j] - previous[j]), 1.0);  // 1000 N m/s trips the robot
    }
    previous = tau;
  }
  EXPECT_GT(filter.not_finite_count(), 100);
}

TEST(TorqueFilter, LeavesAnAllowedTorqueAlone) {
  TorqueFilter filter;
  const JointVector previous = JointVector::Constant(3.0), asked = JointVector::Constant(3.5);
  EXPECT_TRUE(filter.limit(asked, previous).isApprox(asked));
}

}  // namespace
}  // namespace tandem
