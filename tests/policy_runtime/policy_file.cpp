#include "policy_runtime/policy_file.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <random>

#include "policy_runtime/policy.h"

namespace tandem::policy::testing {
namespace {

using Json = nlohmann::json;

// Of bfloat16, the upper bytes of a float are kept.
std::size_t bytes_of_a_number(const Tensor& tensor) {
  return tensor.dtype == "U8" ? 1 : tensor.dtype == "BF16" ? 2 : 4;
}

double apply(const std::string& activation, double x) {
  if (activation == "relu") return x > 0 ? x : 0;
  if (activation == "tanh") return std::tanh(x);
  return 0.5 * x * (1 + std::tanh(std::sqrt(2 / M_PI) * (x + 0.044715 * x * x * x)));
}

void layer_norm(std::vector<double>& y, const Tensor& scale, const Tensor& offset) {
  double mean = 0, variance = 0;
  for (const double v : y) mean += v / y.size();
  for (const double v : y) variance += (v - mean) * (v - mean) / y.size();
  for (std::size_t i = 0; i < y.size(); ++i) {
    y[i] = (y[i] - mean) / std::sqrt(variance + 1e-6) * scale.values[i] + offset.values[i];
  }
}

}  // namespace

std::string PolicyFile::header() const {
  Json json = {{"__metadata__", metadata}};
  std::int64_t begin = 0;
  for (const auto& [name, tensor] : tensors) {
    const std::int64_t end = begin + tensor.values.size() * bytes_of_a_number(tensor);
    json[name] = {{"dtype", tensor.dtype}, {"shape", tensor.shape}, {"data_offsets", {begin, end}}};
    begin = end;
  }
  return json.dump();
}

std::string PolicyFile::data() const {
  std::string bytes;
  for (const auto& [name, tensor] : tensors) {
    const std::size_t kept = bytes_of_a_number(tensor);
    for (const float& value : tensor.values) {
      if (tensor.dtype == "U8") {
        const float pixel = value >= 0.0f && value <= 255.0f ? value : 0.0f;
        bytes.push_back(static_cast<char>(static_cast<unsigned char>(pixel)));
        continue;
      }
      bytes.append(reinterpret_cast<const char*>(&value) + sizeof value - kept, kept);
    }
  }
  return bytes;
}

Tensor random_tensor(std::vector<std::int64_t> shape, float mean, float deviation,
                     std::mt19937& random) {
  std::int64_t size = 1;
  for (const auto dimension : shape) size *= dimension;
  std::normal_distribution<float> normal(mean, deviation);
  Tensor made{std::move(shape), std::vector<float>(size)};
  for (float& value : made.values) value = normal(random);
  return made;
}

PolicyFile make_file(const std::string& architecture, const std::string& config,
                     int observation_size, const std::vector<std::string>& axes, int version,
                     std::mt19937& random) {
  std::vector<std::string> names;
  for (int i = 0; i < observation_size; ++i) names.push_back("observation_" + std::to_string(i));
  PolicyFile file;
  file.metadata = {{"format", "tandem-policy-1"},
                   {"architecture", architecture},
                   {"config", config},
                   {"observation", Json(names).dump()},
                   {"action", Json(axes).dump()},
                   {"task", "peg"},
                   {"method", "tandem"},
                   {"execution", R"({"mode":"receding","execute":1})"},
                   {"discount", "0.98"},
                   {"version", std::to_string(version)},
                   {"env_steps", "4000"},
                   {"updates", "8000"},
                   {"episodes_trained_through", "31"},
                   {"git_revision", "abc123"}};
  file.tensors["normalizer.mean"] = random_tensor({observation_size}, 0.0f, 1.0f, random);
  file.tensors["normalizer.scale"] = random_tensor({observation_size}, 1.0f, 0.3f, random);
  return file;
}

std::vector<double> normalised(const PolicyFile& file, const float* observation) {
  const Tensor& mean = file.tensors.at("normalizer.mean");
  const Tensor& scale = file.tensors.at("normalizer.scale");
  std::vector<double> x(mean.values.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    x[i] = (double{observation[i]} - mean.values[i]) * scale.values[i];
  }
  return x;
}

void add_perceptron(PolicyFile& file, const std::string& prefix, const PerceptronSpec& spec, int in,
                    int out, std::mt19937& random) {
  std::vector<int> widths = spec.hidden;
  widths.push_back(out);
  for (std::size_t i = 0; i < widths.size(); ++i) {
    const std::string layer = prefix + ".layers." + std::to_string(i);
    const int width = widths[i];
    file.tensors[layer + ".weight"] =
        random_tensor({width, in}, 0.0f, 1.0f / std::sqrt(float(in)), random);
    file.tensors[layer + ".bias"] = random_tensor({width}, 0.0f, 0.3f, random);
    if (spec.layer_norm && i + 1 < widths.size()) {
      file.tensors[layer + ".norm_scale"] = random_tensor({width}, 1.0f, 0.2f, random);
      file.tensors[layer + ".norm_offset"] = random_tensor({width}, 0.0f, 0.2f, random);
    }
    in = width;
  }
}

std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                             const PerceptronSpec& spec, std::vector<double> x) {
  for (std::size_t l = 0; l <= spec.hidden.size(); ++l) {
    const std::string layer = prefix + ".layers." + std::to_string(l);
    const Tensor& weight = file.tensors.at(layer + ".weight");
    const Tensor& bias = file.tensors.at(layer + ".bias");
    std::vector<double> y(bias.values.begin(), bias.values.end());
    for (std::size_t row = 0; row < y.size(); ++row) {
      for (std::size_t i = 0; i < x.size(); ++i)
        y[row] += double{weight.values[row * x.size() + i]} * x[i];
    }
    if (l < spec.hidden.size()) {
      if (spec.layer_norm) {
        layer_norm(y, file.tensors.at(layer + ".norm_scale"),
                   file.tensors.at(layer + ".norm_offset"));
      }
      for (double& value : y) value = apply(spec.activation, value);
    }
    x = std::move(y);
  }
  return x;
}

PolicyFile make_mlp(const MlpSpec& spec, unsigned seed) {
  std::mt19937 random(seed);
  const int O = spec.observation_size, axes = static_cast<int>(spec.axes.size());
  const Json config = {{"hidden", spec.hidden},
                       {"activation", spec.activation},
                       {"layer_norm", spec.layer_norm},
                       {"horizon", spec.horizon},
                       {"output", "tanh"}};
  PolicyFile file = make_file("mlp", config.dump(), O, spec.axes, spec.version, random);
  add_perceptron(file, "actor", {spec.hidden, spec.activation, spec.layer_norm}, O,
                 spec.horizon * axes, random);

  const std::int64_t N = 8;
  const Tensor observations = random_tensor({N, O}, 0.0f, 1.0f, random);
  Tensor chunks{{N, spec.horizon, axes}, {}};
  for (std::int64_t n = 0; n < N; ++n) {
    const auto chunk = evaluate(file, spec, &observations.values[n * O]);
    chunks.values.insert(chunks.values.end(), chunk.begin(), chunk.end());
  }
  file.tensors["golden.observation"] = observations;
  file.tensors["golden.chunk"] = chunks;
  return file;
}

std::vector<double> evaluate(const PolicyFile& file, const MlpSpec& spec,
                             const float* observation) {
  auto chunk = evaluate(file, "actor", {spec.hidden, spec.activation, spec.layer_norm},
                        normalised(file, observation));
  for (double& value : chunk) value = std::tanh(value);
  return chunk;
}

std::string safetensors(const std::string& header, const std::string& data) {
  const std::uint64_t length = header.size();
  return std::string(reinterpret_cast<const char*>(&length), sizeof length) + header + data;
}

std::string write_file(const std::string& bytes) {
  struct Folder {  // gone with the test program
    std::filesystem::path path =
        ::testing::TempDir() + "policy_runtime_" + std::to_string(getpid());
    int count = 0;
    Folder() { std::filesystem::create_directories(path); }
    ~Folder() { std::filesystem::remove_all(path); }
  };
  static Folder folder;
  const auto path = folder.path / (std::to_string(folder.count++) + ".safetensors");
  std::ofstream(path, std::ios::binary) << bytes;
  return path;
}

std::string write_file(const PolicyFile& file) {
  return write_file(safetensors(file.header(), file.data()));
}

std::string refusal(const std::string& path) {
  try {
    Policy::load(path);
  } catch (const PolicyError& error) {
    EXPECT_TRUE(std::string(error.what()).starts_with(path)) << error.what();
    return error.what();
  }
  return "";
}

}  // namespace tandem::policy::testing
