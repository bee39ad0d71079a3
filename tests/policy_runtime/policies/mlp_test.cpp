#include <gtest/gtest.h>

#include <limits>
#include <new>
#include <random>

#include "policy_runtime/policy.h"
#include "policy_runtime/policy_file.h"
#include "support/allocation_counter.h"

namespace tandem::policy::testing {
namespace {

std::vector<float> random_observation(int n, std::mt19937& random) {
  std::normal_distribution<float> normal(0.0f, 2.0f);
  std::vector<float> observation(n);
  for (float& value : observation) value = normal(random);
  return observation;
}

TEST(Mlp, AgreesWithTheFormulaInDoublePrecision) {
  const MlpSpec specs[] = {
      {.observation_size = 1, .hidden = {}, .axes = {"x"}, .horizon = 1},
      {.observation_size = 26, .hidden = {256, 256}, .axes = {"x", "y", "z", "rz"}, .horizon = 1},
      {.observation_size = 17,
       .hidden = {3},
       .axes = {"gripper"},
       .horizon = 5,
       .activation = "tanh"},
      {.observation_size = 40,
       .hidden = {129, 63, 31},
       .horizon = 8,
       .activation = "gelu",
       .layer_norm = true},
      {.observation_size = 5,
       .hidden = {1, 1},
       .horizon = 3,
       .activation = "relu",
       .layer_norm = true},
  };
  std::mt19937 random(1);
  for (const MlpSpec& spec : specs) {
    const PolicyFile file = make_mlp(spec, 7);
    const auto policy = Policy::load(write_file(file));
    Workspace workspace = policy->make_workspace();
    std::vector<float> chunk(policy->header().chunk_size());
    for (int n = 0; n < 50; ++n) {
      const auto observation = random_observation(spec.observation_size, random);
      ASSERT_TRUE(policy->forward({.observation = observation.data()}, chunk.data(), workspace));
      const auto expected = evaluate(file, spec, observation.data());
      for (std::size_t i = 0; i < chunk.size(); ++i) ASSERT_NEAR(chunk[i], expected[i], 1e-5);
    }
  }
}

TEST(Mlp, NeitherAllocatesNorRemembersInForward) {
  const MlpSpec spec{.hidden = {100, 50}, .activation = "gelu", .layer_norm = true};
  const auto policy = Policy::load(write_file(make_mlp(spec)));
  Workspace workspace = policy->make_workspace();
  std::mt19937 random(2);
  const auto first = random_observation(7, random), other = random_observation(7, random);
  std::vector<float> before(6), after(6);

  const tandem::testing::AllocationCounter allocations;
  bool usable = policy->forward({.observation = first.data()}, before.data(), workspace);
  for (int n = 0; n < 10000; ++n)
    usable = policy->forward({.observation = other.data()}, after.data(), workspace) && usable;
  usable = policy->forward({.observation = first.data()}, after.data(), workspace) && usable;
  EXPECT_EQ(allocations.count(), 0);

  EXPECT_TRUE(usable);
  EXPECT_EQ(before, after) << "the same observation must give the same bits";
}

TEST(Mlp, AllocationCounterCounts) {
  const tandem::testing::AllocationCounter allocations;
  ::operator delete(::operator new(8));  // unlike new int, calls that may not be optimised away
  ::operator delete[](::operator new[](8, std::align_val_t{64}), std::align_val_t{64});
  EXPECT_EQ(allocations.count(), 2);
}

TEST(Mlp, AnswersAnUnusableObservationWithZerosAndFalse) {
  const auto policy = Policy::load(write_file(make_mlp({})));
  Workspace workspace = policy->make_workspace();
  std::mt19937 random(3);
  const auto good = random_observation(7, random);
  std::vector<float> expected(6), chunk(6);
  ASSERT_TRUE(policy->forward({.observation = good.data()}, expected.data(), workspace));
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    for (int i = 0; i < 7; ++i) {
      auto observation = good;
      observation[i] = bad;
      EXPECT_FALSE(policy->forward({.observation = observation.data()}, chunk.data(), workspace));
      EXPECT_EQ(chunk, std::vector<float>(6, 0.0f));
    }
  }
  ASSERT_TRUE(policy->forward({.observation = good.data()}, chunk.data(), workspace));
  EXPECT_EQ(chunk, expected) << "a bad observation must leave no trace";
}

}  // namespace
}  // namespace tandem::policy::testing
