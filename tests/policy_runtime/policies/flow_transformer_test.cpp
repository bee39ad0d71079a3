#include <gtest/gtest.h>

#include "policy_runtime/act_file.h"
#include "policy_runtime/file/config_reader.h"
#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/policies/flow.h"

namespace tandem::policy::testing {
namespace {

using Json = nlohmann::json;

FlowTransformerFormula small() {
  return {{.observation = 7, .horizon = 3}, {.transformer = {.decoder_layers = 2}}};
}

TEST(FlowTransformer, AgreesWithTheFormulaInDoublePrecision) {
  const FlowTransformerFormula heads[] = {
      small(),
      {{1, {"x"}, 1},
       {.transformer = {.model_size = 1, .heads = 1, .feedforward = 1, .encoder_layers = 0},
        .tokens = {1},
        .steps = 1,
        .time_features = 2}},
      {{9, {"x", "y", "z", "rx", "ry", "rz", "gripper"}, 5},
       {.transformer = {.model_size = 10,
                        .heads = 1,
                        .feedforward = 33,
                        .encoder_layers = 0,
                        .decoder_layers = 3,
                        .activation = "gelu"},
        .tokens = {2, 1, 6},
        .steps = 3,
        .time_features = 10}},
      {{40, {"x", "y", "z", "gripper"}, 16},
       {.transformer = {.model_size = 64, .heads = 4, .feedforward = 80, .encoder_layers = 1},
        .tokens = {33, 7},
        .steps = 10,
        .time_features = 64}},
  };
  for (const FlowTransformerFormula& head : heads) {
    expect_agreement(make_policy(head, 3), head, 10);
  }
}

TEST(FlowTransformer, NeitherAllocatesNorRemembersInForward) {
  expect_real_time_and_repeatable(make_policy(small()), small());
}

TEST(FlowTransformer, MakesSeveralSamplesLikeOneAfterTheOther) {
  SafetensorsFile file(write_file(make_policy(small())));
  const FlowHead head(file, ConfigReader(small().config(), "config"), {"actor", 7, 3});
  expect_same_samples(head, 7);
}

TEST(FlowTransformer, RefusesAConfigOutOfRange) {
  const PolicyFile file = make_policy(small());
  const auto refused = [&](const std::string& pointer, const Json& value) {
    return refused_config(file, pointer, value);
  };
  EXPECT_EQ(refused("/steps", 4), "");
  EXPECT_TRUE(says(refused("/model_size", 4097), "integer in [1, 4096]"));
  EXPECT_TRUE(says(refused("/heads", 5), "model_size 6 and heads 5", "must divide"));
  EXPECT_TRUE(says(refused("/encoder_layers", 17), "integer in [0, 16]"));
  EXPECT_TRUE(says(refused("/decoder_layers", 0), "integer in [1, 16]"));
  EXPECT_TRUE(says(refused("/tokens/0/size", 3), "tokens of 6 numbers", "observation has 7"));
  EXPECT_TRUE(says(refused("/hidden", Json::array()), "unknown key \"hidden\""));
  EXPECT_TRUE(says(refused("/time_features", 8), "time.weight", "asks for (6, 8)"));
  EXPECT_TRUE(says(refused("/horizon", 4), "query_position", "asks for (4, 6)"));
  EXPECT_TRUE(says(refused("/steps", 5), "golden examples differ"));
}

TEST(FlowTransformer, RefusesMissingTensors) {
  const PolicyFile sound = make_policy(small());
  for (const auto& [name, tensor] : sound.tensors) {
    PolicyFile file = sound;
    file.tensors.erase(name);
    EXPECT_TRUE(says(refusal(write_file(file)), "\"" + name + "\" is missing"));
  }
}

}  // namespace
}  // namespace tandem::policy::testing
