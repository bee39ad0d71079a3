#include <gtest/gtest.h>

#include <thread>

#include "base/random.h"
#include "base/sha256.h"
#include "base/spsc_ring.h"

namespace tandem {
namespace {

TEST(SpscRing, KeepsOrderAndLosesNothingBetweenTwoThreads) {
  SpscRing<int> ring(64);
  constexpr int kCount = 200'000;
  std::thread writer([&] {
    for (int i = 0; i < kCount;) {
      if (ring.push(i))
        ++i;
      else
        std::this_thread::yield();
    }
  });
  for (int expected = 0; expected < kCount;) {
    if (const int* value = ring.front()) {
      ASSERT_EQ(*value, expected++);
      ring.pop();
    } else {
      std::this_thread::yield();
    }
  }
  writer.join();
  EXPECT_EQ(ring.size(), 0u);
}

TEST(SpscRing, RefusesWhenFull) {
  SpscRing<int> ring(2);
  EXPECT_TRUE(ring.push(1));
  EXPECT_TRUE(ring.push(2));
  EXPECT_FALSE(ring.push(3));
  EXPECT_EQ(*ring.front(), 1);
}

TEST(Random, SameKeysGiveTheSameNumbersAndOtherKeysOthers) {
  Random a = random_for(7, Purpose::reset), b = random_for(7, Purpose::reset),
         c = random_for(7, Purpose::observation);
  for (int i = 0; i < 100; ++i) {
    const uint64_t x = a.next();
    EXPECT_EQ(x, b.next());
    EXPECT_NE(x, c.next());
  }
}

TEST(Random, NormalHasItsMeanAndDeviation) {
  Random random{42};
  double sum = 0, squares = 0;
  constexpr int kCount = 100'000;
  for (int i = 0; i < kCount; ++i) {
    const double x = random.normal(2.0);
    sum += x;
    squares += x * x;
  }
  EXPECT_NEAR(sum / kCount, 0.0, 0.03);
  EXPECT_NEAR(squares / kCount, 4.0, 0.08);
}

TEST(Sha256, AgreesWithThePublishedExample) {
  Sha256 digest;
  digest.add("a", 1);
  digest.add("bc", 2);
  EXPECT_EQ(digest.hex(), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

}  // namespace
}  // namespace tandem
