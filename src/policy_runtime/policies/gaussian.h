#pragma once

#include "policy_runtime/layers/perceptron.h"
#include "policy_runtime/policies/head.h"
#include "policy_runtime/policies/tanh_normal.h"

namespace tandem::policy {

/// Multi-layer perceptron that gives mean and standard deviation of every number of a chunk:
/// chunk = tanh(mean(x) + std(x) noise). Without noise (zeros) it is the mean action.
///
/// Config: hidden, activation, layer_norm, horizon, log_std_min, log_std_max, output ("tanh").
class GaussianHead final : public Head {
 public:
  GaussianHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec);

  int noise_size() const noexcept override { return chunk_size(); }
  std::size_t workspace_size(int samples) const noexcept override;
  void forward(const HeadInput& input, int samples, float* chunks,
               float* workspace) const noexcept override;

 private:
  struct Config {
    Perceptron::Config perceptron;
    TanhNormal normal;
    int horizon = 1;

    static Config read(ConfigReader& reader);
  };
  GaussianHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec);

  Perceptron perceptron_;  // x -> mean (h A), log_std (h A)
  TanhNormal normal_;
};

}  // namespace tandem::policy
