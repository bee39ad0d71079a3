// How long a ResNet-18 takes for one camera image, one thread. FLOP/s count the multiplications and
// additions of the plain convolution, whatever method computes it; so more than the machine's peak
// is possible. Take the min of the time and the max of the FLOP/s: a busy machine spoils the
// others.
#include "policy_runtime/layers/backbone.h"

#include <benchmark/benchmark.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <vector>

#include "policy_runtime/file/safetensors.h"

namespace {
using namespace tandem::policy;  // NOLINT: a program

/// A safetensors file of random tensors, gone with this object.
class RandomFile {
 public:
  ~RandomFile() { std::filesystem::remove(path_); }

  void add(const std::string& name, const std::vector<std::int64_t>& shape, float low, float high) {
    std::size_t size = 1;
    for (const auto dimension : shape) size *= dimension;
    const std::size_t begin = data_.size() * sizeof(float);
    std::uniform_real_distribution<float> uniform(low, high);
    std::generate_n(std::back_inserter(data_), size, [&] { return uniform(random_); });
    header_["actor." + name] = {{"dtype", "F32"},
                                {"shape", shape},
                                {"data_offsets", {begin, data_.size() * sizeof(float)}}};
  }

  SafetensorsFile open() const {
    const std::string header = header_.dump();
    const std::uint64_t length = header.size();
    std::ofstream stream(path_, std::ios::binary);
    stream.write(reinterpret_cast<const char*>(&length), sizeof length);
    stream << header;
    stream.write(reinterpret_cast<const char*>(data_.data()), data_.size() * sizeof(float));
    stream.close();
    return SafetensorsFile(path_);
  }

 private:
  std::string path_ = std::filesystem::temp_directory_path() /
                      ("tandem_bench_backbone_" + std::to_string(getpid()) + ".safetensors");
  std::mt19937 random_{1};
  nlohmann::json header_;
  std::vector<float> data_;
};

/// Adds a convolution and its batch norm; multiply-adds for `pixels` outputs.
double add_convolution(RandomFile& file, const std::string& name, const std::string& norm, int in,
                       int out, int kernel, double pixels) {
  const float bound = std::sqrt(3.0f / float(in * kernel * kernel));
  file.add("backbone." + name + ".weight", {out, in, kernel, kernel}, -bound, bound);
  file.add("backbone." + norm + ".weight", {out}, 0.8f, 1.2f);
  file.add("backbone." + norm + ".bias", {out}, -0.1f, 0.1f);
  file.add("backbone." + norm + ".running_mean", {out}, -0.1f, 0.1f);
  file.add("backbone." + norm + ".running_var", {out}, 0.8f, 1.2f);
  return pixels * in * out * kernel * kernel;
}

/// Adds the tensors of a ResNet-18; its multiply-adds for a square image.
double add_resnet18(RandomFile& file, int width, int side) {
  file.add("image.mean", {3}, 0.4f, 0.5f);
  file.add("image.scale", {3}, 4.0f, 4.6f);
  const auto halve = [&] { return side = (side + 1) / 2, double(side) * side; };
  double total = add_convolution(file, "conv1", "bn1", 3, width, 7, halve());
  double pixels = halve();
  int in = width;
  for (int stage = 0; stage < 4; ++stage) {
    const int out = width << stage;
    if (in != out) pixels = halve();
    for (int block = 0; block < 2; ++block) {
      const std::string name = "layer" + std::to_string(stage + 1) + "." + std::to_string(block);
      total += add_convolution(file, name + ".conv1", name + ".bn1", in, out, 3, pixels);
      total += add_convolution(file, name + ".conv2", name + ".bn2", out, out, 3, pixels);
      if (in != out) {
        total += add_convolution(file, name + ".downsample.0", name + ".downsample.1", in, out, 1,
                                 pixels);
      }
      in = out;
    }
  }
  return total;
}

struct Network {
  double multiply_adds;
  Backbone backbone;
};

Network make_resnet18(int side) {
  constexpr int kWidth = 64;
  RandomFile made;
  const double multiply_adds = add_resnet18(made, kWidth, side);
  SafetensorsFile file = made.open();
  const nlohmann::json config = {{"kind", "resnet18"}, {"width", kWidth}};
  return {multiply_adds, load_backbone(file, "actor", {config, "backbone"}, side, side)};
}

void resnet18(benchmark::State& state) {
  const int side = int(state.range(0));
  static std::map<int, Network> networks;  // made once, not for every repetition
  if (!networks.contains(side)) networks.emplace(side, make_resnet18(side));
  const Backbone& backbone = networks.at(side).backbone;

  std::vector<std::uint8_t> image(std::size_t(side) * side * 3);
  std::mt19937 random(2);
  for (std::uint8_t& byte : image) byte = static_cast<std::uint8_t>(random());
  const std::size_t stride = padded(backbone.channels());
  AlignedBuffer features(stride * backbone.out_height() * backbone.out_width());
  AlignedBuffer workspace(backbone.workspace_size());
  for (auto _ : state) {
    backbone.forward(kernels(), image.data(), {features.data(), stride}, workspace.data());
    benchmark::DoNotOptimize(features.data());
  }
  state.SetLabel(kernel_name());
  state.counters["FLOP/s"] = benchmark::Counter(2 * networks.at(side).multiply_adds,
                                                benchmark::Counter::kIsIterationInvariantRate);
}

double smallest(const std::vector<double>& all) { return *std::ranges::min_element(all); }
double largest(const std::vector<double>& all) { return *std::ranges::max_element(all); }

BENCHMARK(resnet18)
    ->Arg(96)
    ->Arg(224)
    ->Unit(benchmark::kMillisecond)
    ->Iterations(4)
    ->Repetitions(25)
    ->ComputeStatistics("min", smallest)
    ->ComputeStatistics("max", largest)
    ->ReportAggregatesOnly();

}  // namespace

BENCHMARK_MAIN();
