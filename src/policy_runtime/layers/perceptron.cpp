#include "policy_runtime/layers/perceptron.h"

#include <algorithm>

#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

constexpr int kMaxWidth = 8192;
constexpr std::size_t kMaxHiddenLayers = 16;

}  // namespace

Perceptron::Config Perceptron::Config::read(ConfigReader& reader) {
  return {reader.integers("hidden", 1, kMaxWidth, kMaxHiddenLayers),
          reader.activation("activation"), reader.boolean("layer_norm")};
}

Perceptron::Perceptron(SafetensorsFile& file, const std::string& prefix, const Config& config,
                       int in, int out, Activation output, int first) {
  const auto next = [&] { return prefix + ".layers." + std::to_string(first + layers_.size()); };
  for (const int width : config.hidden) {
    layers_.emplace_back(file, next(), in, width, config.layer_norm, config.activation);
    width_ = std::max(width_, padded(width));
    in = width;
  }
  layers_.emplace_back(file, next(), in, out, false, output);
}

// one layer's output | the next one's
std::size_t Perceptron::workspace_size(int n) const noexcept { return 2 * n * width_; }

void Perceptron::forward(const Kernels& kernels, ConstRows X, int n, Rows Y,
                         float* workspace) const noexcept {
  Scratch scratch(workspace);
  Rows here{scratch.take(n * width_), width_}, next{scratch.take(n * width_), width_};
  for (std::size_t i = 0; i < layers_.size(); ++i) {
    const Rows out = i + 1 == layers_.size() ? Y : here;
    if (n == 1) {
      layers_[i].forward(kernels, X.data, out.data);
    } else {
      layers_[i].forward(kernels, X, n, out);
    }
    X = out;
    std::swap(here, next);
  }
}

}  // namespace tandem::policy
