#include <gtest/gtest.h>

#include "policy_runtime/head_formulas.h"
#include "policy_runtime/policy.h"

namespace tandem::policy::testing {
namespace {

const Sizes kSmall{.observation = 7, .axes = {"x", "y", "rz"}, .horizon = 2};

TEST(Flow, AgreesWithTheFormulaInDoublePrecision) {
  const FlowFormula heads[] = {
      {{1, {"x"}, 1}, {.hidden = {}}, 1, 2},
      {{26, {"x", "y", "z", "rz"}, 4}, {.hidden = {64, 65}, .activation = "gelu"}, 10, 64},
      {{17, {"gripper"}, 5}, {.hidden = {3}, .activation = "tanh"}, 100, 4},
      {{40, {"x", "y", "z"}, 11}, {.hidden = {129, 31, 17}, .layer_norm = true}, 7, 10},
  };
  for (const FlowFormula& head : heads) expect_agreement(make_policy(head, 3), head, 20);
}

TEST(Flow, NeitherAllocatesNorRemembersInForward) {
  const FlowFormula head(kSmall, {.activation = "gelu", .layer_norm = true});
  expect_real_time_and_repeatable(make_policy(head), head);
}

// A field of one constant: the path leaves [-1, 1] on the way and is cut at its end alone.
TEST(Flow, ClipsOnlyTheEndOfThePath) {
  const FlowFormula head({1, {"x"}, 1}, {.hidden = {}}, 10, 2);
  PolicyFile file = make_policy(head);
  for (float& weight : file.tensors["actor.layers.0.weight"].values) weight = 0.0f;
  file.tensors["actor.layers.0.bias"].values = {-3.0f};
  std::mt19937 random(1);
  add_golden(file, head, random);
  const auto policy = Policy::load(write_file(file));
  Workspace workspace = policy->make_workspace();
  const float observation = 0.0f;
  const auto from = [&](float noise) {
    float chunk = 99.0f;
    EXPECT_TRUE(policy->forward({.observation = &observation, .noise = &noise}, &chunk, workspace));
    return chunk;
  };
  EXPECT_NEAR(from(3.5f), 0.5f, 1e-6);
  EXPECT_EQ(from(4.5f), 1.0f);
  EXPECT_EQ(from(0.0f), -1.0f);
}

TEST(Flow, RefusesAConfigOutOfRange) {
  const PolicyFile file = make_policy(FlowFormula(kSmall, {}));
  EXPECT_EQ(refused_config(file, "/steps", 4), "");
  EXPECT_TRUE(says(refused_config(file, "/field", "unet"), "field is \"unet\"",
                   "must be mlp or transformer"));
  EXPECT_TRUE(says(refused_config(file, "/steps", 0), "steps is \"0\"", "[1, 100]"));
  EXPECT_TRUE(says(refused_config(file, "/steps", 101), "steps is \"101\"", "[1, 100]"));
  EXPECT_TRUE(says(refused_config(file, "/time_features", 7), "7 time_features", "even"));
  EXPECT_TRUE(says(refused_config(file, "/time_features", 0), "[2, 256]"));
  EXPECT_TRUE(says(refused_config(file, "/time_features", 258), "[2, 256]"));
  EXPECT_TRUE(says(refused_config(file, "/time_features", 8),
                   "has the shape (19, 19); the metadata asks for (19, 21)"));
  EXPECT_TRUE(says(refused_config(file, "/horizon", 3), "has the shape", "asks for (19, 22)"));
  EXPECT_TRUE(says(refused_config(file, "/output", "tanh"), "must be clip"));
  EXPECT_TRUE(says(refused_config(file, "/heads", 4), "unknown key \"heads\""));
}

}  // namespace
}  // namespace tandem::policy::testing
