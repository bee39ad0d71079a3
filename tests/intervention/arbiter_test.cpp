#include "intervention/arbiter.h"

#include <gtest/gtest.h>

#include <cmath>

#include "base/random.h"

namespace tandem {
namespace {

int ticks_until(Arbiter& arbiter, bool engaged, double alpha) {
  int ticks = 0;
  do {
    ++ticks;
    arbiter.step(engaged);
  } while (engaged ? arbiter.alpha() < alpha : arbiter.alpha() > alpha);
  return ticks;
}

TEST(Arbiter, HumanHasNineTenthsWithinFiftyTicks) {
  Arbiter arbiter(50, 100);
  arbiter.reset(false);
  EXPECT_EQ(ticks_until(arbiter, true, 0.9), 45);
  for (int ramp_in = 1; ramp_in <= 55; ++ramp_in) {
    Arbiter other(ramp_in, 100);
    other.reset(false);
    EXPECT_LE(ticks_until(other, true, 0.9), 50) << ramp_in;
  }
}

TEST(Arbiter, FullSwingTakesExactlyItsTicks) {
  for (const int ramp_in : {1, 3, 7, 50, 55, 333}) {
    for (const int ramp_out : {1, 10, 49, 100, 997}) {
      Arbiter arbiter(ramp_in, ramp_out);
      arbiter.reset(false);
      EXPECT_EQ(ticks_until(arbiter, true, 1.0), ramp_in);
      EXPECT_EQ(ticks_until(arbiter, false, 0.0), ramp_out);
    }
  }
}

TEST(Arbiter, WhateverTheHumanDoesAuthorityMovesInRampsTowardsHim) {
  for (uint64_t seed = 0; seed < 2000; ++seed) {
    Random random{seed};
    const int ramp_in = 1 + static_cast<int>(random.uniform(0, 120));
    const int ramp_out = 1 + static_cast<int>(random.uniform(0, 200));
    const double change = std::pow(10.0, random.uniform(-3, 0));  // bouncing to rare
    Arbiter arbiter(ramp_in, ramp_out);
    bool engaged = random.uniform(0, 1) < 0.5;
    arbiter.reset(engaged);
    double before = arbiter.alpha();
    for (int tick = 0; tick < 1000; ++tick) {
      const bool was_engaged = engaged;
      if (random.uniform(0, 1) < change) engaged = !engaged;
      const double alpha = arbiter.step(engaged);
      ASSERT_EQ(alpha, arbiter.alpha());
      ASSERT_GE(alpha, 0.0);
      ASSERT_LE(alpha, 1.0);
      const double moved = alpha - before;
      if (engaged) {
        ASSERT_GE(moved, 0.0);
        ASSERT_LE(moved, 1.0 / ramp_in + 1e-12);
        ASSERT_TRUE(moved > 0.0 || alpha == 1.0);
      } else {
        ASSERT_LE(moved, 0.0);
        ASSERT_GE(moved, -1.0 / ramp_out - 1e-12);
        ASSERT_TRUE(moved < 0.0 || alpha == 0.0);
      }
      ASSERT_EQ(arbiter.took_over(), engaged && !was_engaged);
      ASSERT_EQ(arbiter.released(), !engaged && was_engaged);
      before = alpha;
    }
  }
}

TEST(Arbiter, LettingGoInTheMiddleOfTheRampTurnsItRoundWhereItIs) {
  Arbiter arbiter(50, 100);
  arbiter.reset(false);
  for (int tick = 0; tick < 20; ++tick) arbiter.step(true);
  EXPECT_NEAR(arbiter.alpha(), 0.40, 1e-12);
  arbiter.step(false);
  EXPECT_NEAR(arbiter.alpha(), 0.39, 1e-12);
  arbiter.step(true);
  EXPECT_NEAR(arbiter.alpha(), 0.41, 1e-12);
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
