#include <gtest/gtest.h>

#include <cmath>

#include "policy_runtime/head_formulas.h"
#include "policy_runtime/policy.h"

namespace tandem::policy::testing {
namespace {

const Sizes kSmall{.observation = 7, .axes = {"x", "y", "rz"}, .horizon = 2};

TEST(Gaussian, AgreesWithTheFormulaInDoublePrecision) {
  const GaussianFormula heads[] = {
      {{1, {"x"}, 1}, {.hidden = {}}},
      {{26, {"x", "y", "z", "rz"}, 4}, {.hidden = {64, 65}, .activation = "gelu"}},
      {{17, {"gripper"}, 5}, {.hidden = {3}, .activation = "tanh"}, -1.0, -0.5},
      {{40, {"x", "y", "z"}, 11}, {.hidden = {129, 31}, .layer_norm = true}, 0.0, 0.0},
  };
  for (const GaussianFormula& head : heads) expect_agreement(make_policy(head, 3), head, 30);
}

TEST(Gaussian, NeitherAllocatesNorRemembersInForward) {
  const GaussianFormula head(kSmall, {.activation = "gelu", .layer_norm = true});
  expect_real_time_and_repeatable(make_policy(head), head);
}

TEST(Gaussian, GivesTheMeanActionWithoutNoise) {
  const GaussianFormula head(kSmall, {});
  const PolicyFile file = make_policy(head);
  const auto policy = Policy::load(write_file(file));
  Workspace workspace = policy->make_workspace();
  std::mt19937 random(1);
  const auto observation = random_numbers(7, 1.0f, random);
  const std::vector<float> zeros(6);
  std::vector<float> chunk(6);
  ASSERT_TRUE(policy->forward({.observation = observation.data(), .noise = zeros.data()},
                              chunk.data(), workspace));
  const auto parameters = evaluate(file, "actor", head.spec, normalised(file, observation.data()));
  for (int i = 0; i < 6; ++i) EXPECT_NEAR(chunk[i], std::tanh(parameters[i]), 1e-6);
}

TEST(Gaussian, ClipsTheLogarithmOfTheDeviation) {
  const GaussianFormula head(kSmall, {.hidden = {}}, -3.0, 1.0);
  PolicyFile file = make_policy(head);
  for (int i = 0; i < 6; ++i) {  // far below the range, then far above
    file.tensors["actor.layers.0.bias"].values[6 + i] = i < 3 ? -80.0f : 90.0f;
  }
  std::mt19937 random(2);
  add_golden(file, head, random);
  expect_agreement(file, head, 30);
}

TEST(Gaussian, RefusesAConfigOutOfRange) {
  const PolicyFile file = make_policy(GaussianFormula(kSmall, {}));
  EXPECT_EQ(refused_config(file, "/log_std_min", -5.0), "");
  EXPECT_TRUE(says(refused_config(file, "/log_std_min", -21), "log_std_min is \"-21\"", "[-20"));
  EXPECT_TRUE(says(refused_config(file, "/log_std_max", "2"), "log_std_max is", "a number in"));
  EXPECT_TRUE(says(refused_config(file, "/log_std_min", 3.0), "log_std_min above log_std_max"));
  EXPECT_TRUE(says(refused_config(file, "/horizon", 257), "horizon is \"257\"", "[1, 256]"));
  EXPECT_TRUE(says(refused_config(file, "/horizon", 3), "has the shape", "asks for (18, 33)"));
  EXPECT_TRUE(says(refused_config(file, "/output", "linear"), "must be tanh"));
  EXPECT_TRUE(says(refused_config(file, "/dropout", 0.1), "unknown key \"dropout\""));
}

}  // namespace
}  // namespace tandem::policy::testing
