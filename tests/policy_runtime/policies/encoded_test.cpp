#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "policy_runtime/policy.h"
#include "policy_runtime/policy_file.h"
#include "policy_runtime/vision_file.h"
#include "support/allocation_counter.h"

namespace tandem::policy::testing {
namespace {

using Json = nlohmann::json;

constexpr int kObservation = 5, kFeatures = 9, kHeight = 17, kWidth = 24, kExamples = 8;
const std::vector<CnnLayer> kLayers = {{7, 5, 3}, {19, 3, 2}};  // no multiple of a vector
const PerceptronSpec kPerceptron = {.hidden = {13, 21}};
const std::vector<std::string> kAxes = {"x", "y"};

Json config() {
  const Json head = {{"hidden", kPerceptron.hidden},
                     {"activation", "relu"},
                     {"layer_norm", false},
                     {"horizon", 1},
                     {"output", "tanh"}};
  return {{"cameras", {{{"name", "wrist"}, {"height", kHeight}, {"width", kWidth}}}},
          {"backbone", Json::parse(cnn_config(kLayers))},
          {"features", kFeatures},
          {"head", {{"architecture", "mlp"}, {"config", head}}}};
}

// tanh(norm(W map + b)), an mlp, tanh: straight from the formula.
std::vector<double> chunk_of(const PolicyFile& file, const float* observation,
                             const std::vector<std::uint8_t>& image) {
  PolicyFile actor;  // under the name that the backbone's formula knows
  for (const auto& [name, tensor] : file.tensors) {
    if (name.starts_with("encoder.")) actor.tensors["actor." + name.substr(8)] = tensor;
  }
  const Volume map = evaluate_cnn(actor, kLayers, image, kHeight, kWidth);
  const auto tensor = [&](const std::string& name) -> const std::vector<float>& {
    return file.tensors.at("encoder.projection." + name).values;
  };
  std::vector<double> y(kFeatures);
  double mean = 0, variance = 0;
  for (int i = 0; i < kFeatures; ++i) {
    y[i] = tensor("bias")[i];
    for (std::size_t j = 0; j < map.values.size(); ++j)
      y[i] += tensor("weight")[i * map.values.size() + j] * map.values[j];
    mean += y[i] / kFeatures;
  }
  for (const double value : y) variance += (value - mean) * (value - mean) / kFeatures;
  std::vector<double> x = normalised(file, observation);
  for (int i = 0; i < kFeatures; ++i) {
    const double normal = (y[i] - mean) / std::sqrt(variance + 1e-6);
    x.push_back(std::tanh(normal * tensor("norm_scale")[i] + tensor("norm_offset")[i]));
  }
  std::vector<double> chunk = evaluate(file, "actor", kPerceptron, x);
  for (double& value : chunk) value = std::tanh(value);
  return chunk;
}

PolicyFile make_encoded() {
  std::mt19937 random(3);
  PolicyFile file = make_file("encoded", config().dump(), kObservation, kAxes, 1, random);
  for (const auto& [name, tensor] : make_cnn(kLayers).tensors) {
    if (name.starts_with("actor.")) file.tensors["encoder." + name.substr(6)] = tensor;
  }
  const int flat = 3 * 4 * 19;  // 17 x 24 -> 6 x 8 -> 3 x 4
  const std::string name = "encoder.projection.";
  file.tensors[name + "weight"] = random_tensor({kFeatures, flat}, 0.0f, 0.1f, random);
  file.tensors[name + "bias"] = random_tensor({kFeatures}, 0.0f, 0.3f, random);
  file.tensors[name + "norm_scale"] = random_tensor({kFeatures}, 1.0f, 0.1f, random);
  file.tensors[name + "norm_offset"] = random_tensor({kFeatures}, 0.0f, 0.1f, random);
  add_perceptron(file, "actor", kPerceptron, kObservation + kFeatures, 2, random);

  Tensor& observation = file.tensors["golden.observation"];
  observation = random_tensor({kExamples, kObservation}, 0.0f, 1.0f, random);
  Tensor chunk{{kExamples, 1, 2}, {}}, images{{kExamples, kHeight, kWidth, 3}, {}, "U8"};
  for (int n = 0; n < kExamples; ++n) {
    const auto image = random_image(kHeight, kWidth, n);
    images.values.insert(images.values.end(), image.begin(), image.end());
    for (const double value : chunk_of(file, &observation.values[n * kObservation], image))
      chunk.values.push_back(static_cast<float>(value));
  }
  file.tensors["golden.chunk"] = chunk;
  file.tensors["golden.image.wrist"] = images;
  return file;
}

std::string refused(const std::string& pointer, const Json& value) {
  PolicyFile file = make_encoded();
  Json changed = config();
  changed[Json::json_pointer(pointer)] = value;
  file.metadata["config"] = changed.dump();
  return refusal(write_file(file));
}

TEST(Encoded, AgreesWithTheFormulaInDoublePrecision) {
  const auto policy = Policy::load(write_file(make_encoded()));
  EXPECT_LT(policy->golden_error(), 1e-5);
  ASSERT_EQ(policy->cameras().size(), 1u);
  EXPECT_EQ(policy->cameras()[0], (Camera{"wrist", kHeight, kWidth}));
}

TEST(Encoded, EvaluatesWithoutAllocatingAndRepeatsItsBits) {
  const PolicyFile file = make_encoded();
  const auto policy = Policy::load(write_file(file));
  Workspace workspace = policy->make_workspace();
  const std::vector<float> observation(kObservation, 0.3f);
  const auto one = random_image(kHeight, kWidth, 20), two = random_image(kHeight, kWidth, 21);
  std::vector<float> first(2), other(2), again(2);
  const auto run = [&](const std::vector<std::uint8_t>& image, std::vector<float>& chunk) {
    const std::uint8_t* const images[1] = {image.data()};
    return policy->forward({.observation = observation.data(), .images = images}, chunk.data(),
                           workspace);
  };
  const tandem::testing::AllocationCounter allocations;
  const bool usable = run(one, first) && run(two, other) && run(one, again);
  EXPECT_EQ(allocations.count(), 0);
  EXPECT_TRUE(usable);
  EXPECT_EQ(first, again);
  EXPECT_NE(first, other);
  EXPECT_FALSE(policy->forward({.observation = observation.data()}, first.data(), workspace))
      << "without images";
}

TEST(Encoded, RefusesAConfigOutOfRange) {
  EXPECT_EQ(refused("/features", kFeatures), "");
  EXPECT_TRUE(says(refused("/features", 0), "[1, 4096]"));
  EXPECT_TRUE(says(refused("/features", 10), "actor.layers.0.weight"));
  EXPECT_TRUE(says(refused("/cameras", Json::array()), "cameras"));
  EXPECT_TRUE(says(refused("/backbone", nullptr), "backbone"));
  EXPECT_TRUE(says(refused("/head/architecture", "encoded"), "encoded again"));
  EXPECT_TRUE(says(refused("/head/architecture", "lstm"), "\"lstm\"", "this runtime knows"));
  EXPECT_TRUE(says(refused("/head/samples", 2), "unknown key \"samples\""));
  EXPECT_TRUE(says(refused("/zoom", 2), "unknown key \"zoom\""));
}

}  // namespace
}  // namespace tandem::policy::testing
