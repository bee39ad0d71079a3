// Apart from the formulas, which the fuzzer uses too: no counter of allocations may be linked
// there.
#include <gtest/gtest.h>

#include "policy_runtime/head_formulas.h"
#include "policy_runtime/policy.h"
#include "support/allocation_counter.h"

namespace tandem::policy::testing {

void expect_real_time_and_repeatable(const PolicyFile& file, const HeadFormula& head) {
  const auto policy = Policy::load(write_file(file));
  Workspace workspace = policy->make_workspace();
  std::mt19937 random(6);
  const auto one = random_numbers(head.sizes.observation, 1.0f, random);
  const auto two = random_numbers(head.sizes.observation, 1.0f, random);
  const auto noise = random_numbers(head.noise_size(), 1.0f, random);
  std::vector<float> first(head.sizes.chunk()), again(first), seeded(first), reseeded(first),
      other(first);

  const tandem::testing::AllocationCounter allocations;
  const auto run = [&](const std::vector<float>& observation, const float* given,
                       std::uint64_t seed, std::vector<float>& chunk) {
    return policy->forward({.observation = observation.data(), .noise = given, .seed = seed},
                           chunk.data(), workspace);
  };
  bool usable = run(one, noise.data(), 0, first) && run(one, nullptr, 7, seeded);
  for (std::uint64_t seed = 0; seed < 200; ++seed)
    usable = run(two, nullptr, seed, other) && usable;
  usable = run(one, noise.data(), 1, again) && run(one, nullptr, 7, reseeded) &&
           run(one, nullptr, 8, other) && usable;
  EXPECT_EQ(allocations.count(), 0);

  EXPECT_TRUE(usable);
  EXPECT_EQ(first, again) << "the same noise must give the same bits, whatever came between";
  EXPECT_EQ(seeded, reseeded) << "the same seed must give the same bits";
  if (head.noise_size() == 0) return;
  EXPECT_NE(seeded, other) << "another seed must give another chunk";
}

}  // namespace tandem::policy::testing
