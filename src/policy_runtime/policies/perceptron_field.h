#pragma once

#include "policy_runtime/layers/split_perceptron.h"
#include "policy_runtime/policies/velocity_field.h"

namespace tandem::policy {

/// v = perceptron([x, a, phi(t)]). Of the first layer, the time's part is multiplied at load and
/// the observation's once per observe().
class PerceptronField final : public VelocityField {
 public:
  /// Takes PREFIX.layers.{i}.*.
  /// @param phi (K, F) the time features of every step
  /// @throws PolicyError
  PerceptronField(SafetensorsFile& file, const std::string& prefix,
                  const Perceptron::Config& config, int observation_size, int chunk_size,
                  std::vector<std::vector<double>> phi);

  std::size_t workspace_size(int samples) const noexcept override;
  void observe(const float* x, float* workspace) const noexcept override;
  void velocity(int step, ConstRows A, int samples, Rows V,
                float* workspace) const noexcept override;

 private:
  SplitPerceptron perceptron_;
};

}  // namespace tandem::policy
