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

std::string layer(std::size_t i) { return "actor.layers." + std::to_string(i); }

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
    const std::int64_t end = begin + tensor.values.size() * (tensor.dtype == "BF16" ? 2 : 4);
    json[name] = {{"dtype", tensor.dtype}, {"shape", tensor.shape}, {"data_offsets", {begin, end}}};
    begin = end;
  }
  return json.dump();
}

std::string PolicyFile::data() const {
  std::string bytes;
  for (const auto& [name, tensor] : tensors) {
    const std::size_t kept = tensor.dtype == "BF16" ? 2 : 4;  // the upper bytes of a float
    for (const float& value : tensor.values) {
      bytes.append(reinterpret_cast<const char*>(&value) + sizeof value - kept, kept);
    }
  }
  return bytes;
}

PolicyFile make_mlp(const MlpSpec& spec, unsigned seed) {
  std::mt19937 random(seed);
  const auto tensor = [&](std::vector<std::int64_t> shape, float mean, float deviation) {
    std::int64_t size = 1;
    for (const auto dimension : shape) size *= dimension;
    std::normal_distribution<float> normal(mean, deviation);
    Tensor made{std::move(shape), std::vector<float>(size)};
    for (float& value : made.values) value = normal(random);
    return made;
  };

  PolicyFile file;
  std::vector<std::string> names;
  for (int i = 0; i < spec.observation_size; ++i)
    names.push_back("observation_" + std::to_string(i));
  const Json config = {{"hidden", spec.hidden},
                       {"activation", spec.activation},
                       {"layer_norm", spec.layer_norm},
                       {"horizon", spec.horizon},
                       {"output", "tanh"}};
  file.metadata = {{"format", "tandem-policy-1"},
                   {"architecture", "mlp"},
                   {"config", config.dump()},
                   {"observation", Json(names).dump()},
                   {"action", Json(spec.axes).dump()},
                   {"task", "peg"},
                   {"method", "tandem"},
                   {"execution", R"({"mode":"receding","execute":1})"},
                   {"discount", "0.98"},
                   {"version", std::to_string(spec.version)},
                   {"env_steps", "4000"},
                   {"updates", "8000"},
                   {"episodes_trained_through", "31"},
                   {"git_revision", "abc123"}};

  std::int64_t in = spec.observation_size;
  std::vector<int> widths = spec.hidden;
  const int axes = static_cast<int>(spec.axes.size());
  widths.push_back(spec.horizon * axes);
  for (std::size_t i = 0; i < widths.size(); ++i) {
    const std::int64_t out = widths[i];
    file.tensors[layer(i) + ".weight"] = tensor({out, in}, 0.0f, 1.0f / std::sqrt(float(in)));
    file.tensors[layer(i) + ".bias"] = tensor({out}, 0.0f, 0.3f);
    if (spec.layer_norm && i + 1 < widths.size()) {
      file.tensors[layer(i) + ".norm_scale"] = tensor({out}, 1.0f, 0.2f);
      file.tensors[layer(i) + ".norm_offset"] = tensor({out}, 0.0f, 0.2f);
    }
    in = out;
  }
  file.tensors["normalizer.mean"] = tensor({spec.observation_size}, 0.0f, 1.0f);
  file.tensors["normalizer.scale"] = tensor({spec.observation_size}, 1.0f, 0.3f);

  const std::int64_t N = 8;
  const Tensor observations = tensor({N, spec.observation_size}, 0.0f, 1.0f);
  Tensor chunks{{N, spec.horizon, axes}, {}};
  for (std::int64_t n = 0; n < N; ++n) {
    const auto chunk = evaluate(file, spec, &observations.values[n * spec.observation_size]);
    chunks.values.insert(chunks.values.end(), chunk.begin(), chunk.end());
  }
  file.tensors["golden.observation"] = observations;
  file.tensors["golden.chunk"] = chunks;
  return file;
}

std::vector<double> evaluate(const PolicyFile& file, const MlpSpec& spec,
                             const float* observation) {
  std::vector<double> x(spec.observation_size);
  for (int i = 0; i < spec.observation_size; ++i) {
    x[i] = (double{observation[i]} - file.tensors.at("normalizer.mean").values[i]) *
           file.tensors.at("normalizer.scale").values[i];
  }
  for (std::size_t l = 0; l <= spec.hidden.size(); ++l) {
    const Tensor& weight = file.tensors.at(layer(l) + ".weight");
    const Tensor& bias = file.tensors.at(layer(l) + ".bias");
    std::vector<double> y(bias.values.begin(), bias.values.end());
    for (std::size_t row = 0; row < y.size(); ++row) {
      for (std::size_t i = 0; i < x.size(); ++i)
        y[row] += double{weight.values[row * x.size() + i]} * x[i];
    }
    const bool last = l == spec.hidden.size();
    if (spec.layer_norm && !last) {
      layer_norm(y, file.tensors.at(layer(l) + ".norm_scale"),
                 file.tensors.at(layer(l) + ".norm_offset"));
    }
    for (double& value : y) value = last ? std::tanh(value) : apply(spec.activation, value);
    x = std::move(y);
  }
  return x;
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
