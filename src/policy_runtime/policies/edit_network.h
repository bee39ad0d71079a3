#pragma once

#include "policy_runtime/layers/split_perceptron.h"
#include "policy_runtime/policies/tanh_normal.h"

namespace tandem::policy {

/// Small learned corrections of chunks:
///
///   edited = clip(a + scale tanh(mean + std noise), -1, 1),  [mean, log_std] = perceptron([x, a])
///
/// Config: hidden, activation, layer_norm, scale, log_std_min, log_std_max.
class EditNetwork {
 public:
  struct Config {
    Perceptron::Config perceptron;
    TanhNormal normal;
    float scale = 0.0f;

    /// @throws PolicyError
    static Config read(ConfigReader reader);
  };

  /// Takes edit.layers.{i}.*. @throws PolicyError
  EditNetwork(SafetensorsFile& file, const Config& config, int observation_size, int chunk_size);

  /// Floats of scratch for n chunks.
  std::size_t workspace_size(int n) const noexcept;

  /// chunks (n, h A) -> edited (n, h A), row strides padded. Real-time.
  /// @param noise (n, h A) without padding
  void forward(const float* x, const float* noise, const float* chunks, int n, float* edited,
               float* workspace) const noexcept;

 private:
  int chunk_size_;
  SplitPerceptron perceptron_;
  TanhNormal normal_;
  float scale_;
};

}  // namespace tandem::policy
