#pragma once

#include <string>
#include <vector>

#include "policy_runtime/file/config_reader.h"
#include "policy_runtime/layers/dense.h"

namespace tandem::policy {

/// Dense layers in a row: x -> act(norm(W_i x + b_i)) for every hidden layer -> W x + b.
class Perceptron {
 public:
  /// What a config says about the hidden layers.
  struct Config {
    std::vector<int> hidden;  ///< widths; empty = a linear map
    Activation activation = Activation::kRelu;
    bool layer_norm = false;

    /// Reads hidden, activation and layer_norm. @throws PolicyError
    static Config read(ConfigReader& reader);
  };

  /// Takes PREFIX.layers.{i}.* from i = first on; the last layer has no norm. @throws PolicyError
  Perceptron(SafetensorsFile& file, const std::string& prefix, const Config& config, int in,
             int out, Activation output, int first = 0);

  /// Floats of scratch for n rows.
  std::size_t workspace_size(int n) const noexcept;

  /// X (n, in) -> Y (n, out), row strides padded. Real-time.
  void forward(const Kernels& kernels, ConstRows X, int n, Rows Y, float* workspace) const noexcept;

 private:
  std::vector<Dense> layers_;
  std::size_t width_ = 0;  // floats: the widest padded hidden layer
};

}  // namespace tandem::policy
