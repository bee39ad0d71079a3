#include "policy_runtime/layers/backbone.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/policy_error.h"
#include "policy_runtime/vision_file.h"
#include "support/allocation_counter.h"

namespace tandem::policy {
namespace {

using testing::CnnLayer;
using testing::PolicyFile;
using testing::says;

Backbone load(const PolicyFile& policy, const std::string& config, int height, int width) {
  SafetensorsFile file(testing::write_file(policy));
  Backbone backbone = load_backbone(
      file, "actor", {nlohmann::json::parse(config), "file: config.backbone"}, height, width);
  file.refuse_unused();
  return backbone;
}

std::string refusal(const PolicyFile& policy, const std::string& config, int height = 32,
                    int width = 32) {
  try {
    load(policy, config, height, width);
  } catch (const PolicyError& error) {
    return error.what();
  }
  return "";
}

// In memory of exactly the counted size, full of garbage.
std::vector<float> run(const Backbone& backbone, const std::vector<std::uint8_t>& image,
                       std::size_t stride, const Kernels& kernels) {
  AlignedBuffer features(std::size_t(backbone.out_height()) * backbone.out_width() * stride);
  AlignedBuffer workspace(backbone.workspace_size());
  std::fill_n(features.data(), features.size(), 1e30f);
  std::fill_n(workspace.data(), workspace.size(), 1e30f);
  backbone.forward(kernels, image.data(), {features.data(), stride}, workspace.data());
  return {features.data(), features.data() + features.size()};
}

void expect_features(const Backbone& backbone, const std::vector<std::uint8_t>& image,
                     const testing::Volume& expected) {
  ASSERT_EQ(backbone.out_height(), expected.height);
  ASSERT_EQ(backbone.out_width(), expected.width);
  ASSERT_EQ(backbone.channels(), expected.channels);
  double largest = 0;
  for (const double value : expected.values) largest = std::fmax(largest, value);
  ASSERT_GT(largest, 0.1) << "a dead network proves nothing";

  const int C = expected.channels;
  const std::size_t stride = padded(C) + kPadding;  // a caller may leave a gap
  std::vector<Kernels> all = simd_kernels();
  all.push_back(scalar_kernels());
  for (const Kernels& kernels : all) {
    const std::vector<float> features = run(backbone, image, stride, kernels);
    for (int i = 0; i < expected.height * expected.width; ++i) {
      for (int c = 0; c < int(stride); ++c) {
        const double wanted = c < C                ? expected.values[std::size_t(i) * C + c]
                              : c < int(padded(C)) ? 0.0
                                                   : 1e30f;
        ASSERT_NEAR(features[i * stride + c], wanted, 5e-6 * std::fmax(1.0, largest))
            << kernels.name << " pixel " << i << " channel " << c;
      }
    }
  }
}

TEST(Backbone, ResNet18AgreesWithDoublePrecision) {
  const PolicyFile file = testing::make_resnet18(8);
  for (const auto& [height, width] : {std::pair{96, 64}, {33, 47}, {8, 9}}) {
    const auto image = testing::random_image(height, width);
    expect_features(load(file, testing::resnet18_config(8), height, width), image,
                    testing::evaluate_resnet18(file, image, height, width));
  }
}

TEST(Backbone, CnnAgreesWithDoublePrecision) {
  const std::vector<std::vector<CnnLayer>> networks = {
      {{5, 1, 1}},
      {{8, 7, 2}, {17, 3, 1}, {33, 3, 1}, {16, 1, 1}},
      {{32, 5, 2}, {32, 3, 2}, {32, 3, 1}, {7, 5, 3}, {20, 7, 1}},
      {{16, 3, 4}, {16, 3, 4}, {16, 3, 4}, {16, 3, 4}, {16, 3, 4}},
  };
  for (const auto& layers : networks) {
    const PolicyFile file = testing::make_cnn(layers);
    for (const auto& [height, width] : {std::pair{24, 31}, {9, 8}}) {
      const auto image = testing::random_image(height, width);
      expect_features(load(file, testing::cnn_config(layers), height, width), image,
                      testing::evaluate_cnn(file, layers, image, height, width));
    }
  }
}

TEST(Backbone, TakesBfloat16WeightsAsTheyAre) {
  const std::vector<CnnLayer> layers = {{16, 3, 2}, {16, 3, 1}};
  PolicyFile file = testing::make_cnn(layers);
  for (const std::string name : {"actor.backbone.0.weight", "actor.backbone.1.weight"}) {
    testing::Tensor& tensor = file.tensors[name];
    for (float& value : tensor.values) value = std::round(value * 256) / 256;  // fits in 8 bits
    tensor.dtype = "BF16";
  }
  const auto image = testing::random_image(20, 20);
  expect_features(load(file, testing::cnn_config(layers), 20, 20), image,
                  testing::evaluate_cnn(file, layers, image, 20, 20));
}

TEST(Backbone, NeitherAllocatesNorRemembersInForward) {
  const Backbone backbone = load(testing::make_resnet18(8), testing::resnet18_config(8), 40, 40);
  const auto image = testing::random_image(40, 40), other = testing::random_image(40, 40, 2);
  AlignedBuffer workspace(backbone.workspace_size());
  const std::size_t stride = padded(backbone.channels());
  const std::size_t size = stride * backbone.out_height() * backbone.out_width();
  AlignedBuffer first(size), second(size);
  const Kernels& chosen = kernels();

  const tandem::testing::AllocationCounter allocations;
  backbone.forward(chosen, image.data(), {first.data(), stride}, workspace.data());
  backbone.forward(chosen, other.data(), {second.data(), stride}, workspace.data());
  backbone.forward(chosen, image.data(), {second.data(), stride}, workspace.data());
  EXPECT_EQ(allocations.count(), 0);
  for (std::size_t i = 0; i < size; ++i) ASSERT_EQ(first.data()[i], second.data()[i]) << i;
}

TEST(Backbone, RefusesConfigsInASentence) {
  const PolicyFile file = testing::make_cnn({{16, 3, 2}});
  const auto cnn = [](const std::string& layer) {
    return R"({"kind":"cnn","layers":[{)" + layer + "}]}";
  };
  EXPECT_TRUE(says(refusal(file, R"({"kind":"vgg"})"), "file: config.backbone", "kind", "vgg",
                   "resnet18 or cnn"));
  EXPECT_TRUE(says(refusal(file, R"({"kind":"resnet18","width":257})"), "width is", "[1, 256]"));
  EXPECT_TRUE(says(refusal(file, R"({"kind":"resnet18","width":8,"x":1})"), "unknown key"));
  EXPECT_TRUE(says(refusal(file, R"({"kind":"cnn","layers":[]})"), "layers is", "1 to 16"));
  EXPECT_TRUE(says(refusal(file, testing::cnn_config({17, CnnLayer{8, 1, 1}})), "1 to 16"));
  EXPECT_TRUE(says(refusal(file, cnn(R"("channels":2049,"kernel":3,"stride":1)")),
                   "layers[0] channels", "[1, 2048]"));
  EXPECT_TRUE(
      says(refusal(file, cnn(R"("channels":16,"kernel":9,"stride":1)")), "kernel is", "[1, 7]"));
  EXPECT_TRUE(says(refusal(file, cnn(R"("channels":16,"kernel":4,"stride":1)")),
                   "layers[0] has the kernel 4", "odd"));
  EXPECT_TRUE(
      says(refusal(file, cnn(R"("channels":16,"kernel":3,"stride":5)")), "stride is", "[1, 4]"));
  EXPECT_TRUE(says(refusal(file, cnn(R"("channels":16,"kernel":3,"stride":1,"bias":0)")),
                   "layers[0] has the unknown key", "bias"));
}

TEST(Backbone, RefusesImagesThatAreTooSmallOrTooLarge) {
  const std::vector<CnnLayer> layers = {{16, 3, 2}};
  const PolicyFile file = testing::make_cnn(layers);
  const std::string config = testing::cnn_config(layers);
  EXPECT_TRUE(says(refusal(file, config, 7, 32), "7 x 32", "[8, 1024]"));
  EXPECT_TRUE(says(refusal(file, config, 32, 1025), "32 x 1025", "[8, 1024]"));
  EXPECT_EQ(refusal(file, config, 8, 1024), "");
}

// Before anything is sized by it.
TEST(Backbone, RefusesMapsThatWouldFillTheMemory) {
  const std::vector<CnnLayer> layers = {{2048, 1, 1}};
  EXPECT_TRUE(says(refusal(testing::make_cnn(layers), testing::cnn_config(layers), 1024, 1024),
                   "1024 x 1024 pixels with 2048 channels", "at most 67108864"));
}

TEST(Backbone, RefusesTensorsOfAnotherNetwork) {
  const std::string config = testing::resnet18_config(8);
  PolicyFile file = testing::make_resnet18(8);
  file.tensors.erase("actor.backbone.layer2.0.downsample.0.weight");
  EXPECT_TRUE(says(refusal(file, config), "layer2.0.downsample.0.weight", "missing"));
  EXPECT_TRUE(says(refusal(testing::make_resnet18(9), config), "conv1.weight", "(9, 3, 7, 7)",
                   "(8, 3, 7, 7)"));
  file = testing::make_resnet18(8);
  file.tensors["actor.backbone.layer1.0.bn2.running_var"].values[3] = -0.5f;
  EXPECT_TRUE(says(refusal(file, config), "layer1.0.bn2.running_var", "negative at element 3"));
  file = testing::make_resnet18(8);
  file.tensors["actor.image.scale"].shape = {3, 1};
  EXPECT_TRUE(says(refusal(file, config), "actor.image.scale", "(3, 1)"));
}

}  // namespace
}  // namespace tandem::policy
