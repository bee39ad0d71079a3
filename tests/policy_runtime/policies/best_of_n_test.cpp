#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "policy_runtime/act_file.h"
#include "policy_runtime/head_formulas.h"
#include "policy_runtime/kernels/kernels.h"
#include "policy_runtime/policy.h"

namespace tandem::policy::testing {
namespace {

const Sizes kSmall{.observation = 7, .axes = {"x", "y", "rz"}, .horizon = 2};

std::shared_ptr<const HeadFormula> mlp(const Sizes& sizes) {
  return std::make_shared<MlpFormula>(sizes, PerceptronSpec{.hidden = {9}});
}
std::shared_ptr<const HeadFormula> gaussian(const Sizes& sizes) {
  return std::make_shared<GaussianFormula>(sizes, PerceptronSpec{.hidden = {18, 5}});
}
std::shared_ptr<const HeadFormula> flow(const Sizes& sizes) {
  return std::make_shared<FlowFormula>(sizes, PerceptronSpec{.hidden = {33, 17}}, 3, 4);
}

constexpr bool kNoEdit = false;

BestOfNFormula everything(const Sizes& sizes = kSmall) {
  return {sizes,
          {{mlp(sizes), 1}, {flow(sizes), 3}, {gaussian(sizes), 2}},
          {.spec = {.hidden = {12}}},
          {.spec = {.hidden = {21, 10}, .layer_norm = true}, .members = 3}};
}

// Two mlp heads whose chunks are `first` and `second` everywhere, and critics of few weights.
BestOfNFormula two_constants(const std::string& aggregate, const std::vector<int>& hidden = {}) {
  const Sizes sizes{.observation = 1, .axes = {"x", "y"}, .horizon = 1};
  const auto constant = std::make_shared<MlpFormula>(sizes, PerceptronSpec{.hidden = {}});
  return {sizes,
          {{constant, 1}, {constant, 1}},
          {.spec = {}, .used = kNoEdit},
          {.spec = {.hidden = hidden}, .members = 2, .aggregate = aggregate}};
}

PolicyFile make_two_constants(const BestOfNFormula& head, float first, float second) {
  PolicyFile file = make_policy(head);
  for (auto& [name, tensor] : file.tensors) {
    if (name.starts_with("actor.") || name.starts_with("critic.")) {
      std::fill(tensor.values.begin(), tensor.values.end(), 0.0f);
    }
  }
  file.tensors["actor.0.layers.0.bias"].values.assign(2, std::atanh(first));
  file.tensors["actor.1.layers.0.bias"].values.assign(2, std::atanh(second));
  return file;
}

void expect_golden(PolicyFile& file, float value) {
  std::fill(file.tensors["golden.chunk"].values.begin(), file.tensors["golden.chunk"].values.end(),
            value);
}

TEST(BestOfN, AgreesWithTheFormulaInDoublePrecision) {
  const Sizes tiny{1, {"x"}, 1}, large{26, {"x", "y", "z", "rz"}, 5};
  const BestOfNFormula heads[] = {
      everything(),
      {tiny, {{gaussian(tiny), 1}}, {.used = kNoEdit}, {.spec = {.hidden = {}}, .members = 1}},
      {large,
       {{flow(large), 8}},
       {.used = kNoEdit},
       {.spec = {.hidden = {64, 65}, .activation = "gelu"}, .members = 5, .aggregate = "min"}},
      {large,
       {{gaussian(large), 2}, {gaussian(large), 3}, {mlp(large), 2}},
       {.spec = {.hidden = {33}, .activation = "tanh", .layer_norm = true}, .scale = 0.05},
       {.spec = {.hidden = {16}}, .members = 2, .aggregate = "min"}},
  };
  for (const BestOfNFormula& head : heads) expect_agreement(make_policy(head, 3), head, 30);
}

TEST(BestOfN, NeitherAllocatesNorRemembersInForward) {
  const BestOfNFormula head = everything();
  expect_real_time_and_repeatable(make_policy(head), head);
}

// Without this the comparison with the formula could pass on one candidate that always wins.
TEST(BestOfN, LetsEveryCandidateWinSomeTime) {
  const BestOfNFormula head = everything();
  const PolicyFile file = make_policy(head);
  const auto policy = Policy::load(write_file(file));
  Workspace workspace = policy->make_workspace();
  std::mt19937 random(4);
  std::vector<int> wins(12);
  std::vector<float> chunk(6);
  for (int run = 0; run < 600; ++run) {
    const auto observation = random_numbers(7, 2.0f, random);
    const auto noise = random_numbers(head.noise_size(), 1.0f, random);
    ASSERT_TRUE(policy->forward({.observation = observation.data(), .noise = noise.data()},
                                chunk.data(), workspace));
    const auto all =
        head.candidates(file, "actor", normalised(file, observation.data()), noise.data());
    ASSERT_EQ(all.size(), wins.size());
    for (std::size_t i = 0; i < all.size(); ++i) {
      wins[i] += std::fabs(all[i][0] - chunk[0]) < 1e-5 && std::fabs(all[i][5] - chunk[5]) < 1e-5;
    }
  }
  for (std::size_t i = 0; i < wins.size(); ++i) EXPECT_GT(wins[i], 0) << "candidate " << i;
}

TEST(BestOfN, TakesTheFirstOfEqualScores) {
  const BestOfNFormula head = everything();
  PolicyFile file = make_policy(head);
  for (int m = 0; m < 3; ++m) {  // critics that are blind to the chunk
    Tensor& weight = file.tensors["critic." + std::to_string(m) + ".layers.0.weight"];
    for (std::size_t i = 0; i < weight.values.size(); ++i) {
      if (i % 13 >= 7) weight.values[i] = 0.0f;
    }
  }
  std::mt19937 random(1);
  add_golden(file, head, random);
  expect_agreement(file, head, 20);
}

TEST(BestOfN, AggregatesByMeanOrMinimum) {
  // members 1 and 2 give the first candidate 3 and -1, the second 0.5 and 0.5
  for (const std::string aggregate : {"mean", "min"}) {
    PolicyFile file = make_two_constants(two_constants(aggregate), 0.75f, 0.25f);
    const float weights[] = {5.0f, -3.0f}, biases[] = {-0.75f, 1.25f};
    for (int m = 0; m < 2; ++m) {
      const std::string layer = "critic." + std::to_string(m) + ".layers.0";
      file.tensors[layer + ".weight"].values = {0.0f, weights[m], 0.0f};
      file.tensors[layer + ".bias"].values = {biases[m]};
    }
    expect_golden(file, aggregate == "mean" ? 0.75f : 0.25f);
    EXPECT_EQ(refusal(write_file(file)), "");
  }
}

TEST(BestOfN, NeverTakesAScoreThatIsNotFinite) {
  // with weights this large the score of 0.75 overflows and that of 0.0 does not
  for (const std::string aggregate : {"mean", "min"}) {
    for (const float second_member : {1.0f, -1.0f}) {  // inf + inf, inf - inf
      PolicyFile file = make_two_constants(two_constants(aggregate), 0.75f, 0.0f);
      file.tensors["critic.0.layers.0.weight"].values = {0.0f, 3e38f, 3e38f};
      file.tensors["critic.1.layers.0.weight"].values = {0.0f, second_member * 3e38f,
                                                         second_member * 3e38f};
      expect_golden(file, 0.0f);
      EXPECT_EQ(refusal(write_file(file)), "") << aggregate << " " << second_member;
    }
  }
}

TEST(BestOfN, NeverTakesAScoreOfAMemberThatIsNotANumber) {
  for (const std::string aggregate : {"mean", "min"}) {
    for (const std::string member : {"0", "1"}) {
      PolicyFile file = make_two_constants(two_constants(aggregate, {2}), 0.75f, 0.0f);
      // inf - inf for the first candidate, 0 for the second
      file.tensors["critic." + member + ".layers.0.weight"].values = {0.0f, 3e38f, 3e38f,
                                                                      0.0f, 3e38f, 3e38f};
      file.tensors["critic." + member + ".layers.1.weight"].values = {1.0f, -1.0f};
      expect_golden(file, 0.0f);
      EXPECT_EQ(refusal(write_file(file)), "") << aggregate << " " << member;
    }
  }
}

// An activation may turn what is not a number into one.
TEST(BestOfN, NeverTakesACandidateThatIsNotFinite) {
  const Sizes sizes{.observation = 1, .axes = {"x"}, .horizon = 1};
  const auto broken = std::make_shared<FlowFormula>(sizes, PerceptronSpec{.hidden = {2}}, 1, 2);
  const auto sound = std::make_shared<MlpFormula>(sizes, PerceptronSpec{.hidden = {}});
  const BestOfNFormula head(sizes, {{broken, 1}, {sound, 1}}, {.used = kNoEdit},
                            {.spec = {.hidden = {1}}, .members = 1});
  PolicyFile file = make_policy(head);
  file.tensors["actor.0.layers.0.bias"].values = {3e38f, 3e38f};
  file.tensors["actor.0.layers.0.weight"].values = {0.0f, 0.0f, 3e38f, 0.0f,
                                                    0.0f, 0.0f, 3e38f, 0.0f};
  file.tensors["actor.0.layers.1.weight"].values = {1.0f, -1.0f};  // inf - inf
  file.tensors["actor.1.layers.0.weight"].values = {0.0f};
  file.tensors["actor.1.layers.0.bias"].values = {std::atanh(0.5f)};
  file.tensors["critic.0.layers.0.weight"].values = {0.0f, 1.0f};
  file.tensors["critic.0.layers.0.bias"].values = {0.0f};
  file.tensors["critic.0.layers.1.weight"].values = {-1.0f};  // 0 would beat the sound one's -0.5
  expect_golden(file, 0.5f);
  const std::string path = write_file(file);
  for (const std::string& kernel : available_kernels()) {
    force_kernel(kernel);
    EXPECT_EQ(refusal(path), "") << kernel;
  }
  force_kernel("simd");
}

TEST(BestOfN, IsUnusableWhenNoScoreIsFinite) {
  PolicyFile file = make_two_constants(two_constants("mean"), 0.5f, 0.25f);
  file.tensors["normalizer.mean"].values = {0.0f};
  file.tensors["normalizer.scale"].values = {1.0f};
  file.tensors["critic.0.layers.0.weight"].values = {3e37f, 1.0f, 0.0f};
  file.tensors["critic.1.layers.0.weight"].values = {-3e37f, 1.0f, 0.0f};
  std::fill(file.tensors["golden.observation"].values.begin(),
            file.tensors["golden.observation"].values.end(), 0.0f);
  expect_golden(file, 0.5f);
  const auto policy = Policy::load(write_file(file));
  Workspace workspace = policy->make_workspace();
  std::vector<float> chunk(2, 99.0f);
  float observation = 100.0f;  // inf and -inf: their mean is not a number
  EXPECT_FALSE(policy->forward({.observation = &observation}, chunk.data(), workspace));
  EXPECT_EQ(chunk, std::vector<float>(2, 0.0f));
  observation = 0.0f;
  EXPECT_TRUE(policy->forward({.observation = &observation}, chunk.data(), workspace));
  EXPECT_NEAR(chunk[0], 0.5f, 1e-6) << "a bad score must leave no trace";
}

TEST(BestOfN, RefusesAConfigOutOfRange) {
  const BestOfNFormula head = everything();
  const PolicyFile file = make_policy(head);
  const auto refused = [&](const std::string& pointer, const nlohmann::json& value) {
    return refused_config(file, pointer, value);
  };
  EXPECT_EQ(refused("/horizon", 2), "");
  EXPECT_TRUE(says(refused("/heads", nlohmann::json::array()), "1 to 8 objects"));
  EXPECT_TRUE(says(refused("/heads/1/samples", 0), "config.heads[1] samples is", "[1, 256]"));
  EXPECT_TRUE(says(refused("/heads/1/samples", 257), "samples is \"257\"", "[1, 256]"));
  EXPECT_TRUE(says(refused("/heads/1/samples", 254), "257 samples together", "256"));
  EXPECT_TRUE(says(refused("/heads/1/seed", 1), "heads[1] has the unknown key \"seed\""));
  EXPECT_TRUE(says(refused("/heads/1/config/steps", 101), "heads[1].config steps is \"101\""));
  EXPECT_TRUE(says(refused("/heads/0/architecture", "lstm"), "\"lstm\"", "this runtime knows"));
  EXPECT_TRUE(says(refused("/heads/0/architecture", "best_of_n"), "heads[0] is a best_of_n again"));
  EXPECT_TRUE(says(refused("/edit/scale", 2.5), "scale is \"2.5\"", "[0", "2"));
  EXPECT_TRUE(says(refused("/edit/log_std_min", 2.5), "config.edit", "above log_std_max"));
  EXPECT_TRUE(says(refused("/edit/members", 2), "config.edit has the unknown key \"members\""));
  EXPECT_TRUE(says(refused("/edit", nullptr), "golden.noise\" has the shape"));
  EXPECT_TRUE(says(refused("/critic", nullptr), "config.critic is not a JSON object"));
  EXPECT_TRUE(says(refused("/critic/members", 33), "members is \"33\"", "[1, 32]"));
  EXPECT_TRUE(says(refused("/critic/members", 4), "\"critic.3.layers.0.weight\" is missing"));
  EXPECT_TRUE(says(refused("/critic/aggregate", "max"), "must be mean or min"));
  EXPECT_TRUE(says(refused("/critic/hidden/0", 22), "critic.0.layers.0.weight\" has the shape",
                   "asks for (22, 13)"));
  EXPECT_TRUE(says(refused("/best", true), "unknown key \"best\""));
}

TEST(BestOfN, RefusesHeadsOfAnotherHorizon) {
  Sizes longer = kSmall;
  longer.horizon = 3;
  const BestOfNFormula head(kSmall, {{flow(kSmall), 1}, {mlp(longer), 1}}, {.used = kNoEdit}, {});
  std::mt19937 random(1);
  PolicyFile file = make_file("best_of_n", head.config().dump(), 7, kSmall.axes, 1, random);
  head.add(file, "actor", random);
  EXPECT_TRUE(says(refusal(write_file(file)), "a head with the horizon 3", "the whole, 2"));
}

TEST(BestOfN, ProposesWhatTransformersSampleToo) {
  ActSpec act;
  act.sample_latent = true;
  const BestOfNFormula head(
      kSmall,
      {{std::make_shared<ActFormula>(kSmall, act), 3},
       {std::make_shared<FlowTransformerFormula>(kSmall, FlowTransformerSpec{}), 2}},
      {.used = kNoEdit}, {});
  expect_agreement(make_policy(head), head, 20);
}

TEST(BestOfN, RefusesHeadsThatLookThroughDifferentCameras) {
  ActSpec front, back;
  front.cameras = {{"front", 9, 10}};
  back.cameras = {{"back", 9, 10}};
  const auto refused = [&](const ActSpec& other) {
    const BestOfNFormula head(kSmall,
                              {{std::make_shared<ActFormula>(kSmall, front), 1},
                               {flow(kSmall), 1},
                               {std::make_shared<ActFormula>(kSmall, other), 1}},
                              {.used = kNoEdit}, {});
    std::mt19937 random(1);
    PolicyFile file = make_file("best_of_n", head.config().dump(), 7, kSmall.axes, 1, random);
    head.add(file, "actor", random);
    return refusal(write_file(file));
  };
  EXPECT_TRUE(says(refused(back), "different cameras"));
  EXPECT_TRUE(says(refused(front), "golden.observation")) << "the same cameras are no reason";
}

TEST(BestOfN, RefusesMissingTensors) {
  const PolicyFile whole = make_policy(everything());
  for (const auto& [name, unused] : whole.tensors) {
    PolicyFile file = whole;
    file.tensors.erase(name);
    EXPECT_TRUE(says(refusal(write_file(file)), "\"" + name + "\" is missing"));
  }
}

}  // namespace
}  // namespace tandem::policy::testing
