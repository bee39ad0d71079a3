#include "policy_runtime/layers/split_perceptron.h"

#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

std::vector<std::string> first_layers(std::vector<std::string> prefixes) {
  for (std::string& prefix : prefixes) prefix += ".layers.0";
  return prefixes;
}

}  // namespace

SplitPerceptron::SplitPerceptron(SafetensorsFile& file, const std::vector<std::string>& prefixes,
                                 const Perceptron::Config& config, const SplitInput& input, int out)
    : first_(file, first_layers(prefixes), input, config.hidden.empty() ? out : config.hidden[0],
             config.layer_norm && !config.hidden.empty(),
             config.hidden.empty() ? Activation::kIdentity : config.activation),
      hidden_stride_(first_.width() / prefixes.size()),
      out_stride_(padded(out)) {
  if (config.hidden.empty()) return;
  Perceptron::Config behind = config;
  behind.hidden.erase(behind.hidden.begin());
  for (const std::string& prefix : prefixes) {
    rest_.emplace_back(file, prefix, behind, config.hidden[0], out, Activation::kIdentity, 1);
  }
}

// the first hidden layers | those behind, one network after the other
std::size_t SplitPerceptron::workspace_size(int n) const noexcept {
  return rest_.empty() ? 0 : n * std::size_t(first_.width()) + rest_[0].workspace_size(n);
}

void SplitPerceptron::forward(const Kernels& kernels, const float* base, ConstRows A, int n, Rows Y,
                              float* workspace) const noexcept {
  if (rest_.empty()) return first_.forward(kernels, base, A, n, Y);
  Scratch scratch(workspace);
  const std::size_t stride = first_.width();
  const Rows hidden{scratch.take(n * stride), stride};
  first_.forward(kernels, base, A, n, hidden);
  for (std::size_t m = 0; m < rest_.size(); ++m) {
    rest_[m].forward(kernels, {hidden.data + m * hidden_stride_, stride}, n,
                     {Y.data + m * out_stride_, Y.stride}, scratch.take(0));
  }
}

}  // namespace tandem::policy
