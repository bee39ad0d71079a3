#include "policy_runtime/noise.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace tandem::policy {
namespace {

// The learner draws the same numbers: golden examples and replays depend on it.
TEST(Noise, HasTheValuesOfTheDefinition) {
  struct {
    std::uint64_t seed;
    float values[5];
  } const kKnown[] = {
      {0, {-0.4527577402f, 0.2077660389f, 2.6506058121f, -0.4904228254f, -0.9886041246f}},
      {1, {-0.0282497461f, -1.0656176484f, -0.2279195229f, 0.0830941685f, 0.1030909517f}},
      {12345, {0.5625435185f, 1.9279936268f, 0.9228021975f, 1.8429870754f, -0.6061905462f}},
      {~std::uint64_t{0},
       {0.4038981710f, -0.2471699299f, -1.5578114857f, 0.7785844988f, 0.3776197302f}},
  };
  for (const auto& known : kKnown) {
    float out[5];
    standard_normal(known.seed, out, 5);
    for (int i = 0; i < 5; ++i) EXPECT_NEAR(out[i], known.values[i], 1e-6) << known.seed;
  }
}

TEST(Noise, WritesNoMoreThanAskedForAndTheSameStartAtAnyLength) {
  std::vector<float> all(9);
  standard_normal(3, all.data(), 9);
  for (int n = 0; n < 9; ++n) {
    std::vector<float> some(9, 99.0f);
    standard_normal(3, some.data(), n);
    for (int i = 0; i < 9; ++i) EXPECT_EQ(some[i], i < n ? all[i] : 99.0f) << n << " " << i;
  }
}

TEST(Noise, IsStandardNormal) {
  const int n = 100000;
  std::vector<float> out(n);
  standard_normal(42, out.data(), n);
  double mean = 0, square = 0, within_one = 0, neighbours = 0;
  for (int i = 0; i < n; ++i) {
    mean += out[i] / n;
    square += double{out[i]} * out[i] / n;
    within_one += std::fabs(out[i]) < 1.0f ? 1.0 / n : 0.0;
    neighbours += i > 0 ? double{out[i]} * out[i - 1] / n : 0.0;
  }
  EXPECT_NEAR(mean, 0.0, 0.015);
  EXPECT_NEAR(square, 1.0, 0.02);
  EXPECT_NEAR(within_one, 0.6827, 0.008);
  EXPECT_NEAR(neighbours, 0.0, 0.015);
}

}  // namespace
}  // namespace tandem::policy
