#include "controller/episode/returns.h"

#include <gtest/gtest.h>

namespace tandem {
namespace {

TEST(Returns, SuccessIsDiscountedByTheStepsToGo) {
  const std::vector<double> g = discounted_returns({0, 0, 1}, 0.9);
  EXPECT_DOUBLE_EQ(g[0], 0.81);
  EXPECT_DOUBLE_EQ(g[1], 0.9);
  EXPECT_DOUBLE_EQ(g[2], 1.0);
}

TEST(Returns, TimeoutIsWorthNothing) {
  for (const double g : discounted_returns({0, 0, 0, 0}, 0.98)) EXPECT_EQ(g, 0.0);
}

TEST(Returns, EmptyEpisodeHasNone) { EXPECT_TRUE(discounted_returns({}, 0.9).empty()); }

}  // namespace
}  // namespace tandem
