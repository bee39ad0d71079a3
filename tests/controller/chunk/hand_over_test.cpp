#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "base/random.h"
#include "chunks.h"
#include "controller/chunk/reference_filter.h"
#include "intervention/arbiter.h"

/// From chunk to reference as the loop joins them, without an arm: seams between chunks, late and
/// broken chunks, hand-overs in both directions at any tick, chunks that run out.
namespace tandem::testing {
namespace {

constexpr double kDt = 0.001;
constexpr int kTicks = 1500;

/// What one episode was made of.
struct Story {
  ExecutionSettings execution;
  ReferenceSettings reference;
  Twist action_limit;                 // m, rad per step
  double engage = 0.0, let_go = 0.0;  // probability a tick
  int latency = 0;                    // ticks, largest
  double lost = 0.0;                  // share of chunks that never come
};

Story random_story(Random& random, const ReferenceSettings& reference) {
  const auto whole = [&](int low, int high) {
    return low + static_cast<int>(random.uniform(0.0, 1.0) * (high - low + 1));
  };
  Story story;
  story.execution.mode = static_cast<ExecutionMode>(whole(0, 2));
  story.execution.horizon = whole(1, 16);
  story.execution.execute = whole(1, story.execution.horizon);
  story.execution.ensemble_decay = random.uniform(0.0, 0.5);
  story.execution.noise_chunk = random.uniform(0.0, 0.3);
  story.execution.noise_step = random.uniform(0.0, 0.3);
  story.execution.noise_clip = 0.5;
  story.reference = reference;
  // Up to the peg task's speed and beyond: 0.25 m/s and 2 rad/s on every axis at once.
  const double linear = random.uniform(0.0, 0.025), angular = random.uniform(0.0, 0.2);
  story.action_limit << linear, linear, linear, angular, angular, angular;
  story.engage = random.uniform(0.0, 0.01);
  story.let_go = random.uniform(0.0, 0.02);
  story.latency = whole(0, 150);
  story.lost = random.uniform(0.0, 0.3);
  return story;
}

Action random_action(Random& random) {
  Action action;
  for (int i = 0; i < 7; ++i) {
    // Half of the time at a limit: that is where the jumps are largest.
    const double u = random.uniform(-1.0, 1.0);
    action[i] = random.uniform(0.0, 1.0) < 0.5 ? std::copysign(1.0, u) : u;
  }
  return action;
}

struct Count {
  int64_t seams = 0, take_overs = 0, releases = 0, hold_ticks = 0;
};

void play(uint64_t seed, const ReferenceSettings& reference_settings, Count& count) {
  Random random{77, seed};
  const Story story = random_story(random, reference_settings);
  ChunkExecutor executor(story.execution, Action::Ones(), kTicksPerStep);
  executor.begin_episode(seed, true);
  Arbiter arbiter(50, 100);
  arbiter.reset(false);
  ReferenceFilter filter(story.reference);
  Pose commanded;
  commanded.R = exp_map(Eigen::Vector3d(random.uniform(-3, 3), random.uniform(-3, 3), 0.0));
  filter.reset(commanded);

  Chunk on_the_way;
  int64_t arrival = -1;
  int32_t next_id = 0;
  bool engaged = false;
  Action human = Action::Zero();
  Twist velocity = Twist::Zero();
  for (int64_t tick = 0; tick < kTicks; ++tick) {
    const auto step = static_cast<int32_t>(tick / kTicksPerStep);
    if (tick % kTicksPerStep == 0 && executor.needs_chunk(step)) {
      on_the_way = chunk(next_id++, step, story.execution.horizon);
      on_the_way.observation_tick = tick;
      for (Action& action : on_the_way.actions) action = random_action(random);
      const bool lost = random.uniform(0.0, 1.0) < story.lost;
      arrival = lost ? -1 : tick + static_cast<int64_t>(random.uniform(0.0, story.latency + 1));
    }
    if (tick == arrival && executor.accept(on_the_way, tick) <= Verdict::taken_late) ++count.seams;

    if (random.uniform(0.0, 1.0) < (engaged ? story.let_go : story.engage)) engaged = !engaged;
    if (random.uniform(0.0, 1.0) < 0.02) human = random_action(random);
    const double alpha_before = arbiter.alpha();
    const double alpha = arbiter.step(engaged);
    if (arbiter.released()) executor.invalidate(tick);
    count.take_overs += arbiter.took_over();
    count.releases += arbiter.released();
    count.hold_ticks += !executor.due(step);
    ASSERT_LE(std::abs(alpha - alpha_before), 0.02 + 1e-12);

    // The commanded pose moves by increments: no hand has a target of its own.
    const Action blended = (1.0 - alpha) * executor.action(step, 0.0) + alpha * human;
    const Twist increment =
        blended.head<6>().cwiseProduct(story.action_limit) / static_cast<double>(kTicksPerStep);
    const Pose commanded_before = commanded;
    commanded = add(commanded, increment);
    const Twist stepped = minus(commanded, commanded_before);
    ASSERT_LE(stepped.head<3>().norm(), 0.0005);
    ASSERT_LE(stepped.tail<3>().norm(), 0.005);

    const Pose before = filter.reference().X_WE;
    const PoseReference& now = filter.step(commanded);
    const Twist moved = minus(now.X_WE, before);
    ASSERT_LE(moved.head<3>().norm(), 0.0005 + 1e-12) << "seed " << seed << " tick " << tick;
    ASSERT_LE(moved.tail<3>().norm(), 0.005) << "seed " << seed << " tick " << tick;
    const Twist acceleration = (moved / kDt - velocity) / kDt;
    ASSERT_LE(acceleration.head<3>().norm(), story.reference.acceleration_linear + 1e-6);
    ASSERT_LE(acceleration.tail<3>().norm(), story.reference.acceleration_angular + 1e-6);
    velocity = moved / kDt;
    ASSERT_LE(velocity.head<3>().norm(), story.reference.velocity_linear + 1e-9);
    ASSERT_LE(velocity.tail<3>().norm(), story.reference.velocity_angular + 1e-9);
    ASSERT_LE((velocity - now.V_WE).norm(), 1e-9);
  }
}

TEST(HandOver, ReferenceIsContinuousInPoseAndVelocityAtEverySeamAndHandOver) {
  Section controller = Section::load(std::string(TANDEM_ROOT) + "/config/controller.yaml");
  const ReferenceSettings reference = read_reference(controller.section("reference"));
  Count count;
  for (uint64_t seed = 0; seed < 1500 && !::testing::Test::HasFatalFailure(); ++seed) {
    play(seed, reference, count);
  }
  EXPECT_GT(count.seams, 5000);
  EXPECT_GT(count.take_overs, 3000);
  EXPECT_GT(count.releases, 3000);
  EXPECT_GT(count.hold_ticks, 10'000);
}

TEST(HandOver, HumanWhoAsksForNothingStopsTheArm) {
  ChunkExecutor executor = testing::executor(ExecutionMode::receding, 4);
  Arbiter arbiter(50, 100);
  Chunk forward = chunk(0, 0, 4);
  for (Action& action : forward.actions) action = Action::Unit(0);
  ASSERT_EQ(executor.accept(forward, 0), Verdict::taken);
  double way_after_ramp = 0.0;
  for (int tick = 0; tick < 300; ++tick) {
    const double alpha = arbiter.step(true);
    if (tick >= 50) way_after_ramp += (1.0 - alpha) * executor.action(tick / 100, 0.0)[0];
  }
  EXPECT_EQ(way_after_ramp, 0.0);
}

TEST(HandOver, AfterAHandBackNothingMovesUntilAChunkThatSawIt) {
  ChunkExecutor executor = testing::executor(ExecutionMode::open_loop, 8, 8);
  Arbiter arbiter(50, 100);
  arbiter.reset(true);
  ASSERT_EQ(executor.accept(chunk(0, 0, 8, 0.5), 0), Verdict::taken);
  Chunk asked_before = chunk(1, 2, 8, 0.5);
  for (int tick = 0; tick < 400; ++tick) {
    arbiter.step(tick < 230);
    if (arbiter.released()) executor.invalidate(tick);
    if (tick == 240) {
      EXPECT_EQ(executor.accept(asked_before, tick), Verdict::stale);
    }
    if (tick == 300) {
      EXPECT_EQ(executor.accept(chunk(2, 3, 8, 0.5), tick), Verdict::taken);
    }
    const Action action = executor.action(tick / 100, 0.0);
    if (tick >= 230 && tick < 300) {
      EXPECT_TRUE(action.isZero());
    }
    if (tick >= 300) {
      EXPECT_FALSE(action.isZero());
    }
  }
}

}  // namespace
}  // namespace tandem::testing
