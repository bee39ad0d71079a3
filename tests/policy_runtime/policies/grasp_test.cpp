#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "policy_runtime/head_formulas.h"
#include "policy_runtime/policy.h"

namespace tandem::policy::testing {
namespace {

const std::vector<std::string> kAxes = {"x", "y", "rz", "gripper"};

Sizes without_gripper(Sizes sizes) {
  sizes.axes.pop_back();
  return sizes;
}

GraspFormula of_gaussian(const Sizes& sizes) {
  return {sizes,
          std::make_shared<GaussianFormula>(without_gripper(sizes), PerceptronSpec{}),
          {.hidden = {13}}};
}

// The critic values an open and a closed hand at these, whatever it sees.
PolicyFile valued(float open, float closed) {
  const Sizes sizes{.observation = 3, .axes = kAxes, .horizon = 2};
  const GraspFormula head{sizes,
                          std::make_shared<MlpFormula>(without_gripper(sizes), PerceptronSpec{}),
                          {.hidden = {}}};
  PolicyFile file = make_policy(head);
  auto& weight = file.tensors["grasp.layers.0.weight"].values;
  std::fill(weight.begin(), weight.end(), 0.0f);
  file.tensors["grasp.layers.0.bias"].values = {open, closed};
  std::mt19937 random(1);
  add_golden(file, head, random);
  return file;
}

std::vector<float> chunk_of(const PolicyFile& file) {
  const auto policy = Policy::load(write_file(file));
  Workspace workspace = policy->make_workspace();
  const std::vector<float> observation(3, 0.5f);
  std::vector<float> chunk(policy->header().chunk_size());
  EXPECT_TRUE(policy->forward({.observation = observation.data()}, chunk.data(), workspace));
  return chunk;
}

TEST(Grasp, AgreesWithTheFormulaInDoublePrecision) {
  const Sizes small{.observation = 7, .axes = kAxes, .horizon = 2};
  const Sizes large{40, {"x", "y", "z", "rx", "ry", "rz", "gripper"}, 5};
  const Sizes one{1, {"z", "gripper"}, 1};
  const GraspFormula heads[] = {
      of_gaussian(small),
      {large,
       std::make_shared<FlowFormula>(without_gripper(large), PerceptronSpec{.hidden = {33, 17}}),
       {.hidden = {65, 31}, .activation = "tanh", .layer_norm = true}},
      {one, std::make_shared<MlpFormula>(without_gripper(one), PerceptronSpec{.hidden = {}}), {}},
  };
  for (const GraspFormula& head : heads) expect_agreement(make_policy(head, 3), head, 60);
}

TEST(Grasp, NeitherAllocatesNorRemembersInForward) {
  const GraspFormula head = of_gaussian({.observation = 7, .axes = kAxes, .horizon = 2});
  expect_real_time_and_repeatable(make_policy(head), head);
}

TEST(Grasp, ClosesTheHandWhereClosedIsWorthMoreAndStaysOpenWhenEqual) {
  for (const auto& [open, closed, gripper] :
       {std::tuple{0.1f, 0.2f, 1.0f}, {0.2f, 0.1f, -1.0f}, {0.3f, 0.3f, -1.0f}}) {
    const auto chunk = chunk_of(valued(open, closed));
    EXPECT_EQ(chunk[3], gripper);
    EXPECT_EQ(chunk[7], gripper);
    EXPECT_LT(std::fabs(chunk[0]), 1.0f);  // the arm's axes are its head's
  }
}

TEST(Grasp, RefusesAConfigThatDecidesNoGripper) {
  const PolicyFile file = make_policy(of_gaussian({.observation = 7, .axes = kAxes, .horizon = 2}));
  EXPECT_TRUE(says(refused_config(file, "/head/architecture", "best_of_n"), "must be mlp"));
  EXPECT_TRUE(says(refused_config(file, "/critic/members", 2), "unknown key \"members\""));
  PolicyFile alone = file;
  alone.metadata["action"] = R"(["gripper"])";
  alone.tensors["golden.chunk"].shape = {8, 2, 1};
  alone.tensors["golden.chunk"].values.resize(16);
  EXPECT_TRUE(says(refusal(write_file(alone)), "there is no other axis"));
}

}  // namespace
}  // namespace tandem::policy::testing
