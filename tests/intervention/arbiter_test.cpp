#include "intervention/arbiter.h"

#include <gtest/gtest.h>

#include <cmath>

namespace tandem {
namespace {

TEST(Arbiter, HumanHasNineTenthsWithinFiftyTicks) {
  Arbiter arbiter(50, 100);
  arbiter.reset(false);
  int ticks = 0;
  while (arbiter.step(true) < 0.9) ++ticks;
  EXPECT_LE(ticks, 50);
}

TEST(Arbiter, AuthorityNeverJumps) {
  Arbiter arbiter(50, 100);
  arbiter.reset(false);
  double before = arbiter.alpha();
  for (int tick = 0; tick < 2000; ++tick) {
    const double alpha = arbiter.step((tick / 37) % 3 == 0);
    EXPECT_LE(std::abs(alpha - before), 1.0 / 50 + 1e-12);
    EXPECT_GE(alpha, 0.0);
    EXPECT_LE(alpha, 1.0);
    before = alpha;
  }
}

TEST(Arbiter, TellsTakeOverAndReleaseOnce) {
  Arbiter arbiter(50, 100);
  arbiter.reset(false);
  int taken = 0, released = 0;
  for (int tick = 0; tick < 300; ++tick) {
    arbiter.step(tick >= 100 && tick < 200);
    taken += arbiter.took_over();
    released += arbiter.released();
  }
  EXPECT_EQ(taken, 1);
  EXPECT_EQ(released, 1);
}

TEST(Arbiter, DemonstrationBeginsInTheHumansHands) {
  Arbiter arbiter(50, 100);
  arbiter.reset(true);
  EXPECT_EQ(arbiter.step(true), 1.0);
  EXPECT_FALSE(arbiter.took_over());
}

}  // namespace
}  // namespace tandem
