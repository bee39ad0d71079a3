#include "controller/chunk/chunk_executor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/random.h"
#include "chunks.h"
#include "support/allocation_counter.h"

namespace tandem::testing {
namespace {

constexpr auto kOpenLoop = ExecutionMode::open_loop;
constexpr auto kReceding = ExecutionMode::receding;
constexpr auto kEnsemble = ExecutionMode::temporal_ensembling;

TEST(ChunkExecutor, HoldsBeforeTheFirstChunkAndAfterTheLast) {
  ChunkExecutor e = executor(kOpenLoop, 4, 4);
  EXPECT_TRUE(e.action(0, 0.7).head<6>().isZero());
  EXPECT_EQ(e.action(0, 0.7)[6], 0.7);
  EXPECT_FALSE(e.due(0));
  ASSERT_EQ(e.accept(chunk(0, 0, 4), 0), Verdict::taken);
  EXPECT_TRUE(e.due(3));
  EXPECT_FALSE(e.action(3, 0.7).head<6>().isZero());
  EXPECT_FALSE(e.due(4));
  EXPECT_TRUE(e.action(4, 0.7).head<6>().isZero());
  EXPECT_EQ(e.action(4, 0.7)[6], 0.7);
  EXPECT_EQ(e.index(4), -1);
}

TEST(ChunkExecutor, OpenLoopAsksAgainAfterKSteps) {
  ChunkExecutor e = executor(kOpenLoop, 8, 3);
  EXPECT_TRUE(e.needs_chunk(0));
  ASSERT_EQ(e.accept(chunk(0, 0, 8), 0), Verdict::taken);
  EXPECT_FALSE(e.needs_chunk(1));
  EXPECT_FALSE(e.needs_chunk(2));
  EXPECT_TRUE(e.needs_chunk(3));
}

TEST(ChunkExecutor, RecedingAndEnsemblingAskAtEveryStep) {
  for (const ExecutionMode mode : {kReceding, kEnsemble}) {
    ChunkExecutor e = executor(mode, 8);
    ASSERT_EQ(e.accept(chunk(0, 0, 8), 0), Verdict::taken);
    EXPECT_TRUE(e.needs_chunk(1));
  }
}

TEST(ChunkExecutor, LateChunkTakesOverAtTheStepThatIsReallyDue) {
  ChunkExecutor e = executor(kOpenLoop, 4, 2);
  ASSERT_EQ(e.accept(chunk(0, 4, 4, -0.5), 400), Verdict::taken);
  // Seen at step 6, taken in the middle of step 7: its first action is never executed, and the
  // chunk before goes on meanwhile.
  EXPECT_NEAR(e.action(7, 0.0)[0], -0.2, 1e-12);
  ASSERT_EQ(e.accept(chunk(1, 6, 4, 0.1), 750), Verdict::taken_late);
  EXPECT_EQ(e.index(7), 1);
  EXPECT_NEAR(e.action(7, 0.0)[0], 0.2, 1e-12);
  EXPECT_EQ(e.latency_ticks(), 150);
  ASSERT_EQ(e.accept(chunk(2, 8, 4), 800), Verdict::taken);
  EXPECT_EQ(e.latency_ticks(), 0);
  EXPECT_EQ(e.largest_latency_ticks(), 150);
}

TEST(ChunkExecutor, LatencyWithinTheFirstStepIsLateAndStartsWithTheFirstAction) {
  ChunkExecutor e = executor(kReceding, 1);
  EXPECT_EQ(e.accept(chunk(0, 5, 1), 501), Verdict::taken_late);
  EXPECT_EQ(e.index(5), 0);
  EXPECT_EQ(e.accept(chunk(1, 6, 1), 699), Verdict::taken_late);
  EXPECT_EQ(e.accept(chunk(2, 7, 1), 800), Verdict::expired);
}

TEST(ChunkExecutor, ChunkWhoseStepsAreAllPastIsExpiredAndTheOneBeforeStays) {
  ChunkExecutor e = executor(kOpenLoop, 4, 4);
  ASSERT_EQ(e.accept(chunk(0, 8, 4, 0.3), 800), Verdict::taken);
  EXPECT_EQ(e.accept(chunk(1, 5, 4), 900), Verdict::expired);
  EXPECT_EQ(e.chunk_id(), 0);
  EXPECT_NEAR(e.action(9, 0.0)[0], 0.4, 1e-12);
}

TEST(ChunkExecutor, DuplicateIsRecognisedAmongTheLastSixtyFour) {
  ChunkExecutor e = executor(kReceding, 1);
  for (int id = 0; id < 70; ++id) {
    ASSERT_EQ(e.accept(chunk(id, id, 1), id * 100), Verdict::taken);
  }
  EXPECT_EQ(e.accept(chunk(69, 70, 1), 7000), Verdict::duplicate);
  EXPECT_EQ(e.accept(chunk(6, 70, 1), 7000), Verdict::duplicate);
  EXPECT_EQ(e.accept(chunk(5, 70, 1), 7000), Verdict::out_of_order);
}

TEST(ChunkExecutor, OlderChunkThanTheNewestIsOutOfOrder) {
  ChunkExecutor e = executor(kOpenLoop, 4, 4);
  EXPECT_EQ(e.accept(chunk(-1, 0, 4), 0), Verdict::out_of_order);
  ASSERT_EQ(e.accept(chunk(4, 0, 4), 0), Verdict::taken);
  EXPECT_EQ(e.accept(chunk(3, 0, 4), 0), Verdict::out_of_order);
  EXPECT_EQ(e.chunk_id(), 4);
}

TEST(ChunkExecutor, ChunkFromTheFutureIsRefused) {
  ChunkExecutor e = executor(kOpenLoop, 4, 4);
  EXPECT_EQ(e.accept(chunk(0, 1, 4), 99), Verdict::out_of_order);
  Chunk foreseen = chunk(1, 0, 4);
  foreseen.observation_tick = 100;
  EXPECT_EQ(e.accept(foreseen, 99), Verdict::out_of_order);
  EXPECT_EQ(e.accept(chunk(2, 1, 4), 100), Verdict::taken);
}

TEST(ChunkExecutor, ChunkOfAnOlderPolicyIsStaleWithinAnEpisodeOnly) {
  ChunkExecutor e = executor(kOpenLoop, 4, 4);
  ASSERT_EQ(e.accept(chunk(0, 0, 4), 0), Verdict::taken);
  Chunk old = chunk(1, 0, 4);
  old.policy_version = 6;
  EXPECT_EQ(e.accept(old, 0), Verdict::stale);
  e.begin_episode(2, false);
  EXPECT_EQ(e.accept(old, 0), Verdict::taken);
  EXPECT_EQ(e.policy_version(), 6);
}

TEST(ChunkExecutor, WhatWasSeenBeforeTheHandBackIsStale) {
  ChunkExecutor e = executor(kOpenLoop, 4, 4);
  ASSERT_EQ(e.accept(chunk(0, 0, 4), 0), Verdict::taken);
  e.invalidate(150);
  EXPECT_TRUE(e.action(1, 0.0).isZero());
  EXPECT_FALSE(e.due(1));
  EXPECT_TRUE(e.needs_chunk(1));
  Chunk seen = chunk(1, 1, 4);
  seen.observation_tick = 149;
  EXPECT_EQ(e.accept(seen, 160), Verdict::stale);
  seen.observation_tick = 150;
  EXPECT_EQ(e.accept(seen, 160), Verdict::taken_late);
  e.invalidate(400);
  e.begin_episode(2, false);
  EXPECT_EQ(e.accept(chunk(0, 0, 4), 0), Verdict::taken);
}

TEST(ChunkExecutor, WrongSizeAndNonFiniteChunksAreRefused) {
  ChunkExecutor e = executor(kOpenLoop, 4, 4);
  EXPECT_EQ(e.accept(chunk(0, 0, 3), 0), Verdict::wrong_size);
  EXPECT_EQ(e.accept(chunk(0, 0, 5), 0), Verdict::wrong_size);
  Chunk broken = chunk(0, 0, 4);
  for (const int32_t horizon : {0, -1, kMaxHorizon + 1, std::numeric_limits<int32_t>::max()}) {
    broken.horizon = horizon;
    EXPECT_EQ(e.accept(broken, 0), Verdict::wrong_size);
  }
  for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    broken = chunk(0, 0, 4);
    broken.actions[3][6] = bad;
    EXPECT_EQ(e.accept(broken, 0), Verdict::not_finite);
  }
  // A refusal does not use up the id.
  EXPECT_EQ(e.accept(chunk(0, 0, 4), 0), Verdict::taken);
}

TEST(ChunkExecutor, EveryVerdictIsCounted) {
  ChunkExecutor e = executor(kOpenLoop, 4, 4);
  e.accept(chunk(4, 0, 4), 0);    // taken
  e.accept(chunk(5, 0, 4), 10);   // taken late
  e.accept(chunk(6, 0, 4), 400);  // expired
  e.accept(chunk(5, 0, 4), 10);   // duplicate
  e.accept(chunk(3, 0, 4), 10);   // out of order
  Chunk bad = chunk(7, 0, 4);
  bad.policy_version = 1;
  e.accept(bad, 10);             // stale
  e.accept(chunk(7, 0, 2), 10);  // wrong size
  bad.actions[0][0] = std::nan("");
  e.accept(bad, 10);  // not finite
  const ChunkCounts& counts = e.counts();
  EXPECT_EQ(counts.taken, 2);
  EXPECT_EQ(counts.late, 1);
  EXPECT_EQ(counts.refused, (std::array<int64_t, 6>{1, 1, 1, 1, 1, 1}));
}

TEST(ChunkExecutor, EnsembleIsTheWeightedMeanWithTheOldestHeaviest) {
  ChunkExecutor e = executor(kEnsemble, 4);
  for (int id = 0; id < 3; ++id) {
    Chunk c = chunk(id, id, 4);
    for (int i = 0; i < 4; ++i) c.actions[i].setConstant(id == 0 ? 0.9 : id == 1 ? 0.0 : -0.3);
    ASSERT_EQ(e.accept(c, id * 100), Verdict::taken);
  }
  // Step 2: all three; the zero of the second one counts.
  const double w1 = std::exp(-0.01), w2 = std::exp(-0.02);
  EXPECT_NEAR(e.action(2, 0.0)[0], (0.9 - 0.3 * w2) / (1.0 + w1 + w2), 1e-12);
  // Step 4: the first has run out, the second is the oldest.
  EXPECT_NEAR(e.action(4, 0.0)[0], -0.3 * w1 / (1.0 + w1), 1e-12);
  EXPECT_NEAR(e.action(5, 0.0)[0], -0.3, 1e-12);
  EXPECT_TRUE(e.due(5));
  EXPECT_FALSE(e.due(6));
  EXPECT_EQ(e.index(2), 0);
}

TEST(ChunkExecutor, EnsembleOfTheLongestChunksKeepsThemAll) {
  ChunkExecutor e = executor(kEnsemble, kMaxHorizon);
  double expected = 0.0, weights = 0.0;
  for (int id = 0; id < 2 * kMaxHorizon; ++id) {
    Chunk c = chunk(id, id, kMaxHorizon);
    for (int i = 0; i < kMaxHorizon; ++i) c.actions[i].setConstant(0.01 * id);
    ASSERT_EQ(e.accept(c, id * 100), Verdict::taken);
  }
  for (int i = 0; i < kMaxHorizon; ++i) {
    expected += std::exp(-0.01 * i) * 0.01 * (kMaxHorizon + i);
    weights += std::exp(-0.01 * i);
  }
  EXPECT_NEAR(e.action(2 * kMaxHorizon - 1, 0.0)[2], expected / weights, 1e-12);
}

TEST(ChunkExecutor, EnsembleForgetsWhatWasSeenBeforeTheHandBack) {
  ChunkExecutor e = executor(kEnsemble, 4);
  e.accept(chunk(0, 0, 4, 0.5), 0);
  e.invalidate(100);
  ASSERT_EQ(e.accept(chunk(1, 1, 4, -0.2), 100), Verdict::taken);
  EXPECT_NEAR(e.action(1, 0.0)[0], -0.2, 1e-12);
}

TEST(ChunkExecutor, NoiseIsSeededBoundedAndLeavesMaskAndGripperAlone) {
  Action axes = Action::Ones();
  axes[3] = 0.0;
  ChunkExecutor a = executor(kOpenLoop, 4, 4, axes), b = executor(kOpenLoop, 4, 4, axes);
  ChunkExecutor silent = executor(kOpenLoop, 4, 4, axes);
  a.begin_episode(11, true);
  b.begin_episode(11, true);
  silent.begin_episode(11, false);
  double moved = 0.0;
  for (int id = 0; id < 50; ++id) {
    a.accept(chunk(id, 0, 4), 0);
    b.accept(chunk(id, 0, 4), 0);
    silent.accept(chunk(id, 0, 4), 0);
    for (int step = 0; step < 4; ++step) {
      const Action noisy = a.action(step, 0.0), plain = silent.action(step, 0.0);
      EXPECT_EQ(noisy, b.action(step, 0.0));
      EXPECT_EQ(noisy[3], 0.0);
      EXPECT_EQ(noisy[6], plain[6]);
      EXPECT_LE((noisy - plain).cwiseAbs().maxCoeff(), 0.2 + 1e-12);
      moved += std::abs(noisy[0] - plain[0]);
    }
  }
  EXPECT_GT(moved, 1.0);
}

TEST(ChunkExecutor, NoiseOfAChunkIsCorrelatedOverItsSteps) {
  ChunkExecutor noisy = executor(kOpenLoop, 8, 8);
  noisy.begin_episode(3, true);
  double first_second = 0.0, first_first = 0.0;
  for (int id = 0; id < 2000; ++id) {
    Chunk zero = chunk(id, 0, 8);
    for (Action& action : zero.actions) action.setZero();
    noisy.accept(zero, 0);
    const double first = noisy.action(0, 0.0)[0], last = noisy.action(7, 0.0)[0];
    first_second += first * last;
    first_first += first * first;
  }
  // 0.1^2 / (0.1^2 + 0.05^2) = 0.8, a little changed by the clip.
  EXPECT_NEAR(first_second / first_first, 0.8, 0.08);
}

TEST(ChunkExecutor, ExploringSpeedsUpAnEpisodesMotionByOneFactorAndNeverTheGripper) {
  ExecutionSettings settings;
  settings.mode = kReceding;
  settings.horizon = 1;
  settings.noise_speed = 0.5;
  ChunkExecutor e(settings, Action::Ones(), kTicksPerStep);
  const auto factor = [&](uint64_t episode, bool explore) {
    e.begin_episode(episode, explore);
    e.accept(chunk(0, 0, 1, 0.4), 0);
    const double first = e.action(0, 0.0)[0] / 0.4;
    e.accept(chunk(1, 1, 1, -0.4), 100);
    const Action second = e.action(1, 0.0);
    EXPECT_NEAR(second[5] / -0.4, first, 1e-12);
    EXPECT_EQ(second[6], -0.4);
    return first;
  };
  double slowest = 9.0, fastest = 0.0;
  for (uint64_t episode = 0; episode < 200; ++episode) {
    EXPECT_EQ(factor(episode, false), 1.0);
    slowest = std::min(slowest, factor(episode, true));
    fastest = std::max(fastest, factor(episode, true));
  }
  EXPECT_GE(slowest, 1.0);
  EXPECT_LT(slowest, 1.05);
  EXPECT_GT(fastest, 1.45);
  EXPECT_LE(fastest, 1.5);
}

TEST(ChunkExecutor, WhateverComesTheActionIsInRangeAndEveryChunkIsCounted) {
  for (uint64_t seed = 0; seed < 300; ++seed) {
    Random random{seed};
    const auto whole = [&](int low, int high) {
      return low + static_cast<int>(random.uniform(0.0, 1.0) * (high - low + 1));
    };
    const int horizon = whole(1, kMaxHorizon);
    Action axes = Action::Ones();
    axes[whole(0, 6)] = 0.0;
    ChunkExecutor e =
        executor(static_cast<ExecutionMode>(whole(0, 2)), horizon, whole(1, horizon), axes);
    e.begin_episode(seed, true);
    int64_t offered = 0;
    int32_t newest = -1, version = 0;
    for (int64_t tick = 0; tick < 3000; ++tick) {
      if (random.uniform(0, 1) < 0.03) {
        Chunk c = chunk(whole(0, 80), whole(-5, 35), horizon);
        c.observation_tick = whole(-100, 3100);
        c.policy_version = whole(0, 3) == 0 ? whole(0, 9) : 9;
        for (Action& action : c.actions) action.setConstant(random.uniform(-1e9, 1e9));
        const int broken = whole(0, 9);
        if (broken == 0) c.actions[whole(0, horizon - 1)][whole(0, 6)] = std::nan("");
        if (broken == 1) c.horizon = whole(-40, 70);
        if (broken == 2) c.start_step = std::numeric_limits<int32_t>::min() + whole(0, 3);
        if (broken == 3) c.start_step = std::numeric_limits<int32_t>::max() - whole(0, 3);
        const Verdict verdict = e.accept(c, tick);
        ++offered;
        if (verdict <= Verdict::taken_late) {
          ASSERT_GT(c.id, newest);
          ASSERT_GE(c.policy_version, version);
          newest = c.id;
          version = c.policy_version;
          ASSERT_TRUE(e.due(static_cast<int32_t>(tick / kTicksPerStep)));
        }
      }
      if (random.uniform(0, 1) < 0.003) e.invalidate(tick);
      const auto step = static_cast<int32_t>(tick / kTicksPerStep);
      const Action action = e.action(step, 0.25);
      ASSERT_TRUE(action.allFinite());
      ASSERT_LE(action.cwiseAbs().maxCoeff(), 1.0);
      for (int axis = 0; axis < 6; ++axis) {
        if (axes[axis] == 0.0) {
          ASSERT_EQ(action[axis], 0.0);
        }
      }
      if (!e.due(step)) {
        ASSERT_TRUE(action.head<6>().isZero());
      }
      if (!e.due(step) || axes[6] == 0.0) {
        ASSERT_EQ(action[6], 0.25);
      }
    }
    int64_t counted = e.counts().taken;
    for (const int64_t n : e.counts().refused) counted += n;
    ASSERT_EQ(counted, offered);
  }
}

TEST(ChunkExecutor, DoesNotAllocate) {
  ChunkExecutor e = executor(kEnsemble, kMaxHorizon);
  e.begin_episode(1, true);
  const Chunk prepared = chunk(0, 0, kMaxHorizon);
  const AllocationCounter allocations;
  double sum = 0.0;
  for (int id = 0; id < 100; ++id) {
    Chunk c = prepared;
    c.id = id;
    e.accept(c, id);
    if (id % 7 == 0) e.invalidate(0);
    sum += e.action(0, 0.0)[0];
  }
  EXPECT_EQ(allocations.count(), 0);
  EXPECT_NE(sum, 0.0);
}

}  // namespace
}  // namespace tandem::testing
