#include "policy_runtime/policies/act.h"

#include <gtest/gtest.h>

#include <cmath>

#include "policy_runtime/act_file.h"
#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/policy.h"
#include "support/allocation_counter.h"

namespace tandem::policy::testing {
namespace {

using Json = nlohmann::json;

const std::vector<std::string> kArm = {"x", "y", "z", "rx", "ry", "rz", "gripper"};

ActFormula with_cameras() {
  return {{.observation = 7, .horizon = 3},
          {.transformer = {.model_size = 10, .heads = 2, .decoder_layers = 2},
           .sample_latent = true,
           .cameras = {{"front", 13, 22}, {"wrist", 8, 9}, {"side", 13, 22}}}};
}

TEST(Act, AgreesWithTheFormulaInDoublePrecision) {
  const ActFormula heads[] = {
      {{.observation = 7}, {}},
      {{.observation = 1, .axes = {"x"}, .horizon = 1},
       {.transformer = {.model_size = 1, .heads = 1, .feedforward = 1, .encoder_layers = 1},
        .tokens = {1},
        .latent_size = 1}},
      {{.observation = 9, .horizon = 5},
       {.transformer = {.model_size = 10,
                        .heads = 1,
                        .feedforward = 33,
                        .encoder_layers = 1,
                        .decoder_layers = 2,
                        .activation = "gelu"},
        .tokens = {2, 1, 6},
        .output = "linear"}},
      {{.observation = 7, .horizon = 3},
       {.transformer = {.encoder_layers = 3, .decoder_layers = 3},
        .sample_latent = true,
        .output = "linear"}},
      {{.observation = 40, .axes = kArm, .horizon = 16},
       {.transformer = {.model_size = 128, .heads = 8, .feedforward = 512},
        .tokens = {40},
        .latent_size = 32}},
      {{.observation = 30, .axes = kArm, .horizon = 33},
       {.transformer = {.model_size = 36, .heads = 2, .feedforward = 50, .activation = "gelu"},
        .tokens = {14, 16},
        .latent_size = 17,
        .sample_latent = true}},
  };
  for (const ActFormula& head : heads) expect_agreement(make_policy(head, 3), head, 10);
}

// Heads of 16, 8 and 4 numbers: the factor 1 / sqrt(8) would not leave bfloat16 weights exact.
TEST(Act, AgreesWithTheFormulaWhenItsMatricesAreBfloat16) {
  for (const int heads : {3, 6, 12}) {
    const ActFormula head(
        {.observation = 7, .horizon = 3},
        {.transformer = {
             .model_size = 48, .heads = heads, .feedforward = 20, .decoder_layers = 2}});
    PolicyFile file = make_policy(head, heads);
    for (auto& [name, tensor] : file.tensors) {
      if (name.ends_with(".weight")) round_to_bfloat16(tensor);
    }
    std::mt19937 random(1);
    add_golden(file, head, random);
    expect_agreement(file, head, 10);
  }
}

TEST(Act, LooksThroughItsCameras) {
  const ActFormula head = with_cameras();
  const PolicyFile file = make_policy(head);
  const std::string path = write_file(file);
  std::mt19937 random(4);
  for (const std::string& kernel : available_kernels()) {
    force_kernel(kernel);
    const auto policy = Policy::load(path);
    ASSERT_EQ(policy->cameras(), head.spec.cameras);
    Workspace workspace = policy->make_workspace();
    std::vector<float> chunk(head.sizes.chunk());
    for (int run = 0; run < 3; ++run) {
      const auto observation = random_numbers(7, 1.0f, random);
      const auto noise = random_numbers(head.noise_size(), 1.0f, random);
      std::vector<Image> images;
      std::vector<const std::uint8_t*> pointers;
      for (const Camera& camera : head.spec.cameras) {
        images.push_back(random_image(camera.height, camera.width, random()));
        pointers.push_back(images.back().data());
      }
      const Input input{observation.data(), pointers.data(), noise.data()};
      const tandem::testing::AllocationCounter allocations;
      const bool usable = policy->forward(input, chunk.data(), workspace);
      EXPECT_EQ(allocations.count(), 0);
      ASSERT_TRUE(usable);
      const auto expected =
          head.evaluate(file, "actor", normalised(file, observation.data()), noise.data(), images);
      for (std::size_t i = 0; i < chunk.size(); ++i) {
        ASSERT_NEAR(chunk[i], expected[i], 1e-5) << kernel << " number " << i;
      }
    }
    const auto observation = random_numbers(7, 1.0f, random);
    EXPECT_FALSE(policy->forward({.observation = observation.data()}, chunk.data(), workspace))
        << "without images";
  }
  force_kernel("simd");
}

TEST(Act, JudgesItsGoldenExamplesByTheSizeOfTheirActions) {
  ActSpec spec;
  spec.output = "linear";
  const ActFormula head({.observation = 7, .axes = {"shoulder", "elbow"}, .horizon = 3}, spec);
  const auto refused = [&](float scale, float error) {
    PolicyFile file = make_policy(head);
    std::fill_n(file.tensors["actor.output.scale"].values.begin(), 2, scale);
    std::mt19937 random(2);
    add_golden(file, head, random);
    file.tensors["golden.chunk"].values[1] += error;
    return refusal(write_file(file));
  };
  EXPECT_EQ(refused(1000.0f, 1e-3f), "") << "degrees round by more than 1e-5";
  EXPECT_TRUE(says(refused(1000.0f, 1.0f), "golden examples differ"));
  EXPECT_TRUE(says(refused(1e-3f, 1e-3f), "golden examples differ")) << "small ones stay strict";
}

TEST(Act, NeitherAllocatesNorRemembersInForward) {
  for (const bool sample_latent : {false, true}) {
    const ActFormula head({.observation = 7, .horizon = 3},
                          {.transformer = {.decoder_layers = 2}, .sample_latent = sample_latent});
    expect_real_time_and_repeatable(make_policy(head), head);
  }
}

TEST(Act, MakesSeveralSamplesLikeOneAfterTheOther) {
  for (const bool sample_latent : {false, true}) {
    const ActFormula formula(
        {.observation = 7, .horizon = 3},
        {.transformer = {.decoder_layers = 2}, .sample_latent = sample_latent});
    SafetensorsFile file(write_file(make_policy(formula)));
    const ActHead head(file, ConfigReader(formula.config(), "config"), {"actor", 7, 3});
    expect_same_samples(head, 7);
  }
}

TEST(Act, RefusesAConfigOutOfRange) {
  const PolicyFile file = make_policy(ActFormula({.observation = 7}, {}));
  const auto refused = [&](const std::string& pointer, const Json& value) {
    return refused_config(file, pointer, value);
  };
  EXPECT_EQ(refused("/horizon", 2), "");
  EXPECT_TRUE(says(refused("/horizon", 257), "integer in [1, 256]"));
  EXPECT_TRUE(says(refused("/model_size", 0), "integer in [1, 4096]"));
  EXPECT_TRUE(says(refused("/model_size", 4097), "integer in [1, 4096]"));
  EXPECT_TRUE(says(refused("/heads", 0), "integer in [1, 64]"));
  EXPECT_TRUE(says(refused("/heads", 65), "integer in [1, 64]"));
  EXPECT_TRUE(says(refused("/heads", 4), "model_size 6 and heads 4", "must divide"));
  EXPECT_TRUE(says(refused("/feedforward", 16385), "integer in [1, 16384]"));
  EXPECT_TRUE(says(refused("/encoder_layers", 0), "integer in [1, 16]"));
  EXPECT_TRUE(says(refused("/encoder_layers", 17), "integer in [1, 16]"));
  EXPECT_TRUE(says(refused("/decoder_layers", 0), "integer in [1, 16]"));
  EXPECT_TRUE(says(refused("/decoder_layers", 17), "integer in [1, 16]"));
  EXPECT_TRUE(says(refused("/latent_size", 1025), "integer in [1, 1024]"));
  EXPECT_TRUE(says(refused("/activation", "tanh"), "relu or gelu"));
  EXPECT_TRUE(says(refused("/sample_latent", 1), "true or false"));
  EXPECT_TRUE(says(refused("/output", "clip"), "tanh or linear"));
  EXPECT_TRUE(says(refused("/tokens", Json::array()), "1 to 64 objects"));
  EXPECT_TRUE(says(refused("/tokens/0/size", 5), "tokens of 8 numbers", "observation has 7"));
  EXPECT_TRUE(says(refused("/tokens/0/size", 8), "integer in [1, 7]"));
  EXPECT_TRUE(says(refused("/tokens/1/name", ""), "a name of 1 to 64"));
  EXPECT_TRUE(says(refused("/dropout", 0.1), "unknown key \"dropout\""));
  EXPECT_TRUE(says(refused("/backbone", Json::object()), "backbone", "null when there are none"));

  // other tensors than the config asks for
  EXPECT_TRUE(says(refused("/model_size", 9), "has the shape"));
  EXPECT_TRUE(says(refused("/feedforward", 8), "asks for (8, 6)"));
  EXPECT_TRUE(says(refused("/encoder_layers", 3), "encoder.2", "is missing"));
  EXPECT_TRUE(says(refused("/encoder_layers", 1), "encoder.1", "unknown or unused"));
  EXPECT_TRUE(says(refused("/decoder_layers", 2), "decoder.1", "is missing"));
  EXPECT_TRUE(says(refused("/latent_size", 6), "has the shape (6, 5)"));
  EXPECT_TRUE(says(refused("/sample_latent", true), "golden.noise", "is missing"));
  EXPECT_TRUE(says(refused("/output", "linear"), "output.scale\" is missing"));
  EXPECT_TRUE(says(refused("/heads", 1), "golden examples differ"));
  EXPECT_TRUE(says(refused("/activation", "gelu"), "golden examples differ"));
}

TEST(Act, RefusesCamerasThatCannotBe) {
  const PolicyFile file = make_policy(with_cameras());
  const auto refused = [&](const std::string& pointer, const Json& value) {
    return refused_config(file, pointer, value);
  };
  EXPECT_EQ(refused("/horizon", 3), "");
  EXPECT_TRUE(says(refused("/cameras/1/name", "front"), "two cameras named \"front\""));
  EXPECT_TRUE(says(refused("/cameras/1/name", "back"), "camera_position.back", "is missing"));
  EXPECT_TRUE(says(refused("/cameras/0/height", 7), "integer in [8, 1024]"));
  EXPECT_TRUE(says(refused("/cameras/0/width", 1025), "integer in [8, 1024]"));
  EXPECT_TRUE(says(refused("/cameras/0", {{"name", "front"}, {"height", 1000}, {"width", 900}}),
                   "the cameras give", "limit is 4096"));
  EXPECT_TRUE(says(refused("/cameras/0/width", 21), "golden.image.front", "asks for"));
  EXPECT_TRUE(says(refused("/cameras", Json::array()), "null when there are none"));
  EXPECT_TRUE(says(refused("/backbone", nullptr), "needs a backbone"));
  Json nine = Json::array();
  for (int i = 0; i < 9; ++i) {
    nine.push_back({{"name", std::to_string(i)}, {"height", 8}, {"width", 8}});
  }
  EXPECT_TRUE(says(refused("/cameras", nine), "0 to 8 objects"));
}

TEST(Act, RefusesMissingTensors) {
  const PolicyFile sound = make_policy(with_cameras());
  for (const auto& [name, tensor] : sound.tensors) {
    PolicyFile file = sound;
    file.tensors.erase(name);
    EXPECT_TRUE(says(refusal(write_file(file)), "\"" + name + "\" is missing"));
  }
}

}  // namespace
}  // namespace tandem::policy::testing
