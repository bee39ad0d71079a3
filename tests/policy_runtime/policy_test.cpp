#include "policy_runtime/policy.h"

#include <gtest/gtest.h>

#include "policy_runtime/kernels/kernels.h"
#include "policy_runtime/policy_file.h"

namespace tandem::policy::testing {
namespace {

std::string refused_with(const std::string& key, const std::string& value) {
  PolicyFile file = make_mlp({});
  file.metadata[key] = value;
  return refusal(write_file(file));
}

TEST(PolicyLoad, ReadsTheWholeHeader) {
  const auto policy = Policy::load(write_file(make_mlp({.version = 12})));
  const Header& header = policy->header();
  EXPECT_EQ(header.architecture, "mlp");
  EXPECT_EQ(header.task, "peg");
  EXPECT_EQ(header.method, "tandem");
  EXPECT_EQ(header.horizon, 2);
  EXPECT_EQ(header.observation_names.size(), 7u);
  EXPECT_EQ(header.observation_names[6], "observation_6");
  EXPECT_EQ(header.action_axes, (std::vector<std::string>{"x", "y", "rz"}));
  EXPECT_EQ(header.chunk_size(), 6);
  EXPECT_EQ(header.execution, R"({"mode":"receding","execute":1})");
  EXPECT_DOUBLE_EQ(header.discount, 0.98);
  EXPECT_EQ(header.version, 12);
  EXPECT_EQ(header.env_steps, 4000);
  EXPECT_EQ(header.updates, 8000);
  EXPECT_EQ(header.episodes_trained_through, 31);
  EXPECT_EQ(header.git_revision, "abc123");
  EXPECT_LT(policy->golden_error(), 2e-6);
}

TEST(PolicyLoad, RefusesMissingAndUnknownMetadata) {
  for (const auto& [key, unused] : make_mlp({}).metadata) {
    PolicyFile file = make_mlp({});
    file.metadata.erase(key);
    EXPECT_TRUE(says(refusal(write_file(file)), "\"" + key + "\" is missing"));
  }
  EXPECT_TRUE(says(refused_with("colour", "red"), "\"colour\" is unknown"));
}

TEST(PolicyLoad, RefusesMetadataOutOfRange) {
  EXPECT_TRUE(says(refused_with("format", "tandem-policy-9"), "reads tandem-policy-1"));
  EXPECT_TRUE(says(refused_with("architecture", "lstm"), "\"lstm\"", "knows mlp"));
  EXPECT_TRUE(says(refused_with("observation", "[]"), "different names"));
  EXPECT_TRUE(says(refused_with("observation", R"(["a","a"])"), "different names"));
  EXPECT_TRUE(says(refused_with("observation", R"([1,2])"), "different names"));
  EXPECT_TRUE(says(refused_with("execution", "[1]"), "must be a JSON object"));
  EXPECT_TRUE(says(refused_with("execution", R"({"mode":"a","mode":"b"})"), "\"mode\" twice"));
  for (const std::string bad : {"0", "1.1", "-1", "nan", "inf", "0.9x", "", " 0.9", "1e999"}) {
    EXPECT_TRUE(says(refused_with("discount", bad), "must be a number in")) << bad;
  }
  for (const std::string bad : {"-1", "1.5", "99999999999999999999", "x"}) {
    EXPECT_TRUE(says(refused_with("version", bad), "must be a number in")) << bad;
  }
  EXPECT_EQ(refused_with("episodes_trained_through", "-1"), "");
}

TEST(PolicyLoad, RefusesAConfigThatIsNotThisNetwork) {
  const auto config = [](const std::string& hidden, const std::string& rest) {
    return refused_with("config", "{\"hidden\":" + hidden + rest + "}");
  };
  const std::string rest = R"(,"activation":"relu","layer_norm":false,"horizon":2,"output":"tanh")";
  EXPECT_EQ(config("[19,33]", rest), "");
  EXPECT_TRUE(says(config("[19,34]", rest), "the metadata asks for (34, 19)"));
  EXPECT_TRUE(says(config("[19]", rest), "the metadata asks for (6, 19)"));
  EXPECT_TRUE(says(config("[19,33,5]", rest), "asks for (5, 33)"));
  EXPECT_TRUE(says(config("[1000000]", rest), "integers in [1, 8192]"));
  EXPECT_TRUE(says(config("[-1]", rest), "integers in [1, 8192]"));
  EXPECT_TRUE(says(config("[1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1]", rest), "at most 16"));
  EXPECT_TRUE(says(config("[19,33]", rest + ",\"dropout\":0.1"), "unknown key \"dropout\""));
  EXPECT_TRUE(says(config("[19,33]", R"(,"activation":"relu")"), "lacks the key"));
  EXPECT_TRUE(says(
      config("[19,33]", R"(,"activation":"silu","layer_norm":false,"horizon":2,"output":"tanh")"),
      "relu or tanh or gelu"));
  EXPECT_TRUE(says(
      config("[19,33]", R"(,"activation":"relu","layer_norm":true,"horizon":2,"output":"tanh")"),
      "norm_scale\" is missing"));
  EXPECT_TRUE(
      says(config("[19,33]", R"(,"activation":"relu","layer_norm":0,"horizon":2,"output":"tanh")"),
           "true or false"));
  EXPECT_TRUE(says(
      config("[19,33]", R"(,"activation":"relu","layer_norm":false,"horizon":999,"output":"tanh")"),
      "horizon is \"999\""));
  EXPECT_TRUE(says(
      config("[19,33]", R"(,"activation":"relu","layer_norm":false,"horizon":2,"output":"linear")"),
      "must be tanh"));
  EXPECT_TRUE(says(refused_with("config", "[]"), "not a JSON object"));
  EXPECT_TRUE(says(refused_with("config", "{"), "config is not valid JSON"));
}

TEST(PolicyLoad, RefusesMissingTensors) {
  for (const auto& [name, unused] : make_mlp({.layer_norm = true}).tensors) {
    PolicyFile file = make_mlp({.layer_norm = true});
    file.tensors.erase(name);
    EXPECT_TRUE(says(refusal(write_file(file)), "\"" + name + "\" is missing"));
  }
}

TEST(PolicyLoad, RefusesUnknownAndUnusedTensors) {
  for (const std::string name : {"critic.layers.0.weight", "actor.layers.3.weight",
                                 "actor.layers.0.norm_scale", "actor.layers.2.norm_offset"}) {
    PolicyFile file = make_mlp({});
    file.tensors[name] = {{19}, std::vector<float>(19)};
    EXPECT_TRUE(says(refusal(write_file(file)), "\"" + name + "\" is unknown or unused"));
  }
}

TEST(PolicyLoad, RefusesWrongShapes) {
  for (const auto& [name, tensor] : make_mlp({.layer_norm = true}).tensors) {
    PolicyFile file = make_mlp({.layer_norm = true});
    file.tensors[name].shape.push_back(1);  // the same bytes in another shape
    EXPECT_TRUE(says(refusal(write_file(file)), "\"" + name + "\" has the shape", "asks for"));
  }
  PolicyFile transposed = make_mlp({});
  transposed.tensors["actor.layers.0.weight"].shape = {7, 19};
  EXPECT_TRUE(says(refusal(write_file(transposed)),
                   "has the shape (7, 19); the metadata asks for (19, 7)"));
}

TEST(PolicyLoad, RefusesTooFewGoldenExamples) {
  PolicyFile file = make_mlp({});
  file.tensors["golden.observation"] = {{7, 7}, std::vector<float>(49)};
  EXPECT_TRUE(says(refusal(write_file(file)), "7 golden examples; at least 8"));
}

TEST(PolicyLoad, RefusesANetworkThatDisagreesWithItsGoldenExamples) {
  PolicyFile golden = make_mlp({});
  golden.tensors["golden.chunk"].values[0] += 2e-5f;
  EXPECT_TRUE(says(refusal(write_file(golden)), "golden examples differ by", "limit is 1e-05"));

  // the mistakes that a golden example is there for
  PolicyFile normaliser = make_mlp({});
  normaliser.tensors["normalizer.mean"].values[3] += 0.01f;
  EXPECT_TRUE(says(refusal(write_file(normaliser)), "golden examples differ"));
  PolicyFile activation = make_mlp({.activation = "gelu"});
  activation.metadata["config"].replace(activation.metadata["config"].find("gelu"), 4, "relu");
  EXPECT_TRUE(says(refusal(write_file(activation)), "golden examples differ"));
}

TEST(PolicyLoad, RefusesGoldenExamplesThatOverflow) {
  PolicyFile file = make_mlp({});
  file.tensors["golden.observation"].values[0] = 3e38f;
  file.tensors["normalizer.scale"].values[0] = 3e38f;
  EXPECT_TRUE(says(refusal(write_file(file)), "golden examples differ by inf"));
}

TEST(PolicyLoad, AcceptsTheSameFileUnderEveryKernel) {
  const std::string path =
      write_file(make_mlp({.hidden = {65, 130}, .activation = "gelu", .layer_norm = true}));
  for (const std::string& name : available_kernels()) {
    force_kernel(name);
    EXPECT_LT(Policy::load(path)->golden_error(), 2e-6) << name;
  }
  force_kernel("simd");
}

}  // namespace
}  // namespace tandem::policy::testing
