#include "controller/chunk/chunk_executor.h"

#include <gtest/gtest.h>

#include <cmath>

namespace tandem {
namespace {

const Action kAllAxes = Action::Ones();

Chunk chunk(int id, int start_step, int horizon, double first = 0.1) {
  Chunk c;
  c.id = id;
  c.policy_version = 7;
  c.start_step = start_step;
  c.horizon = horizon;
  for (int i = 0; i < horizon; ++i) c.actions[i] = Action::Constant(first + 0.1 * i);
  return c;
}

ChunkExecutor executor(ExecutionMode mode, int execute, const Action& axes = kAllAxes) {
  ExecutionSettings settings;
  settings.mode = mode;
  settings.execute = execute;
  settings.noise_chunk = 0.1;
  settings.noise_step = 0.05;
  settings.noise_clip = 0.2;
  ChunkExecutor e(settings, axes);
  e.begin_episode(1, false);
  return e;
}

TEST(ChunkExecutor, HoldsBeforeTheFirstChunkAndAfterTheLast) {
  ChunkExecutor e = executor(ExecutionMode::open_loop, 4);
  EXPECT_TRUE(e.action(0, 0.7).head<6>().isZero());
  EXPECT_EQ(e.action(0, 0.7)[6], 0.7);
  ASSERT_TRUE(e.accept(chunk(0, 0, 4)));
  EXPECT_FALSE(e.action(3, 0.7).head<6>().isZero());
  EXPECT_TRUE(e.action(4, 0.7).head<6>().isZero());
  EXPECT_EQ(e.index(4), -1);
}

TEST(ChunkExecutor, OpenLoopAsksAgainAfterKSteps) {
  ChunkExecutor e = executor(ExecutionMode::open_loop, 3);
  EXPECT_TRUE(e.needs_chunk(0));
  ASSERT_TRUE(e.accept(chunk(0, 0, 8)));
  EXPECT_FALSE(e.needs_chunk(1));
  EXPECT_FALSE(e.needs_chunk(2));
  EXPECT_TRUE(e.needs_chunk(3));
}

TEST(ChunkExecutor, RecedingAsksAtEveryStep) {
  ChunkExecutor e = executor(ExecutionMode::receding, 1);
  ASSERT_TRUE(e.accept(chunk(0, 0, 8)));
  EXPECT_TRUE(e.needs_chunk(1));
}

TEST(ChunkExecutor, ExecutesTheActionThatIsDueWhenAChunkComesLate) {
  ChunkExecutor e = executor(ExecutionMode::open_loop, 4);
  ASSERT_TRUE(e.accept(chunk(0, 5, 4)));
  EXPECT_NEAR(e.action(7, 0.0)[0], 0.3, 1e-12);
  EXPECT_EQ(e.index(7), 2);
}

TEST(ChunkExecutor, RefusesOldDuplicateAndBrokenChunksAndCountsThem) {
  ChunkExecutor e = executor(ExecutionMode::open_loop, 4);
  ASSERT_TRUE(e.accept(chunk(4, 0, 4)));
  EXPECT_FALSE(e.accept(chunk(4, 0, 4)));
  EXPECT_FALSE(e.accept(chunk(3, 0, 4)));
  Chunk broken = chunk(5, 0, 4);
  broken.actions[2][1] = std::nan("");
  EXPECT_FALSE(e.accept(broken));
  EXPECT_FALSE(e.accept(chunk(6, 0, 0)));
  Chunk long_one = chunk(7, 0, 4);
  long_one.horizon = kMaxHorizon + 1;
  EXPECT_FALSE(e.accept(long_one));
  EXPECT_EQ(e.refused_count(), 5);
  EXPECT_EQ(e.chunk_id(), 4);
}

TEST(ChunkExecutor, InvalidatedChunkHolds) {
  ChunkExecutor e = executor(ExecutionMode::open_loop, 4);
  ASSERT_TRUE(e.accept(chunk(0, 0, 4)));
  e.invalidate();
  EXPECT_TRUE(e.action(1, 0.0).isZero());
  EXPECT_TRUE(e.needs_chunk(1));
}

TEST(ChunkExecutor, NoiseIsSeededBoundedAndLeavesMaskAndGripperAlone) {
  Action axes = kAllAxes;
  axes[3] = 0.0;
  ChunkExecutor a = executor(ExecutionMode::open_loop, 4, axes),
                b = executor(ExecutionMode::open_loop, 4, axes);
  ChunkExecutor silent = executor(ExecutionMode::open_loop, 4, axes);
  a.begin_episode(11, true);
  b.begin_episode(11, true);
  silent.begin_episode(11, false);
  double moved = 0.0;
  for (int id = 0; id < 50; ++id) {
    a.accept(chunk(id, 0, 4));
    b.accept(chunk(id, 0, 4));
    silent.accept(chunk(id, 0, 4));
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

}  // namespace
}  // namespace tandem
