#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <map>
#include <random>
#include <string>
#include <vector>

/// Makes policy files for the tests, sound or broken in one chosen way, by code that shares nothing
/// with the runtime.
namespace tandem::policy::testing {

struct Tensor {
  std::vector<std::int64_t> shape;
  std::vector<float> values;
  std::string dtype = "F32";  ///< BF16 cuts the lower halves of the values off, U8 takes 0..255
};

struct PolicyFile {
  std::map<std::string, std::string> metadata;
  std::map<std::string, Tensor> tensors;

  std::string header() const;  ///< the JSON header
  std::string data() const;    ///< the tensor bytes, in the order of the header's offsets
};

struct MlpSpec {
  int observation_size = 7;
  std::vector<int> hidden = {19, 33};
  std::vector<std::string> axes = {"x", "y", "rz"};
  int horizon = 2;
  std::string activation = "relu";
  bool layer_norm = false;
  int version = 1;
};

/// A tensor of normally distributed numbers.
Tensor random_tensor(std::vector<std::int64_t> shape, float mean, float deviation,
                     std::mt19937& random);

/// Metadata as a learner writes it and a random normaliser; no network, no golden examples.
/// @param config JSON
PolicyFile make_file(const std::string& architecture, const std::string& config,
                     int observation_size, const std::vector<std::string>& axes, int version,
                     std::mt19937& random);

/// The observation as the network sees it, (O).
std::vector<double> normalised(const PolicyFile& file, const float* observation);

struct PerceptronSpec {
  std::vector<int> hidden = {19, 33};
  std::string activation = "relu";
  bool layer_norm = false;
};

/// Adds random tensors PREFIX.layers.{i}.*.
void add_perceptron(PolicyFile& file, const std::string& prefix, const PerceptronSpec& spec, int in,
                    int out, std::mt19937& random);

/// A perceptron in double precision, straight from the formula; its last layer is linear.
std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                             const PerceptronSpec& spec, std::vector<double> x);

/// A sound file: random parameters, golden examples from evaluate().
PolicyFile make_mlp(const MlpSpec& spec, unsigned seed = 1);

/// The network in double precision, straight from the formula: observation (O) -> chunk (h A).
std::vector<double> evaluate(const PolicyFile& file, const MlpSpec& spec, const float* observation);

/// Length prefix, header and data.
std::string safetensors(const std::string& header, const std::string& data);

/// Writes bytes to a fresh file in the test's temporary folder and returns its path.
std::string write_file(const std::string& bytes);
std::string write_file(const PolicyFile& file);

/// The message of the PolicyError that loading raises; "" when it loads.
std::string refusal(const std::string& path);

/// For EXPECT_TRUE: whether the message holds these parts; shows the message when it does not.
template <typename... Parts>
::testing::AssertionResult says(const std::string& message, const Parts&... parts) {
  if ((... && (message.find(parts) != std::string::npos))) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << "the message is: " << message;
}

}  // namespace tandem::policy::testing
