#pragma once

#include "policy_runtime/layers/split_perceptron.h"

namespace tandem::policy {

/// M critics that score chunks: score = mean or min over the members of perceptron_m([x, a]).
///
/// Config: hidden, activation, layer_norm, members (M), aggregate ("mean" or "min").
class CriticEnsemble {
 public:
  enum class Aggregate { kMean, kMin };
  struct Config {
    Perceptron::Config perceptron;
    int members = 1;
    Aggregate aggregate = Aggregate::kMean;

    /// @throws PolicyError
    static Config read(ConfigReader reader);
  };

  /// Takes critic.{m}.layers.{i}.*. @throws PolicyError
  CriticEnsemble(SafetensorsFile& file, const Config& config, int observation_size, int chunk_size);

  /// Floats of scratch for n chunks.
  std::size_t workspace_size(int n) const noexcept;

  /// chunks (n, h A), row stride padded -> scores (n). Real-time. A member that is not a number
  /// makes the score not a number.
  void forward(const float* x, const float* chunks, int n, float* scores,
               float* workspace) const noexcept;

 private:
  float aggregate(const float* values) const noexcept;

  std::size_t chunk_stride_;
  int members_;
  Aggregate aggregate_;
  SplitPerceptron perceptron_;
};

}  // namespace tandem::policy
