#include "controller/chunk/reference_filter.h"

#include <gtest/gtest.h>

#include "base/random.h"

namespace tandem {
namespace {

constexpr double kDt = 0.001;

ReferenceFilter filter() {
  Twist limit;
  limit << 20, 20, 20, 100, 100, 100;
  return ReferenceFilter(80.0, limit);
}

TEST(ReferenceFilter, NeverJumpsMoreThanHalfAMillimetreOrFiveMilliradiansPerTick) {
  ReferenceFilter f = filter();
  f.reset(Pose{});
  Random random{5};
  Pose commanded;
  Pose before = f.reference().X_WE;
  Twist velocity = Twist::Zero();
  for (int tick = 0; tick < 20'000; ++tick) {
    // Ramps that change at random times, as at seams and hand-overs, as fast as an action may be.
    if (random.uniform(0, 1) < 0.02) {
      for (int i = 0; i < 6; ++i) velocity[i] = random.uniform(-1, 1) * (i < 3 ? 0.15 : 1.0);
    }
    commanded = add(commanded, kDt * velocity);
    const Pose now = f.step(commanded).X_WE;
    const Twist jump = minus(now, before);
    ASSERT_LE(jump.head<3>().norm(), 0.0005);
    ASSERT_LE(jump.tail<3>().norm(), 0.005);
    before = now;
  }
}

TEST(ReferenceFilter, ReachesACommandThatStopsWithoutOvershoot) {
  ReferenceFilter f = filter();
  f.reset(Pose{});
  Pose commanded;
  commanded.p.x() = 0.004;
  for (int tick = 0; tick < 300; ++tick) EXPECT_LE(f.step(commanded).X_WE.p.x(), 0.004 + 1e-9);
  EXPECT_NEAR(f.reference().X_WE.p.x(), 0.004, 1e-6);
  EXPECT_NEAR(f.reference().V_WE.norm(), 0.0, 1e-4);
}

}  // namespace
}  // namespace tandem
