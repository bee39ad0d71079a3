#pragma once

#include "policy_runtime/layers/perceptron.h"
#include "policy_runtime/policies/head.h"

namespace tandem::policy {

/// Multi-layer perceptron with a bounded output: chunk = tanh(perceptron(x)).
///
/// Config: hidden, activation, layer_norm, horizon, output ("tanh").
class MlpHead final : public Head {
 public:
  MlpHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec);

  std::size_t workspace_size(int samples) const noexcept override;
  void forward(const HeadInput& input, int samples, float* chunks,
               float* workspace) const noexcept override;

 private:
  struct Config {
    Perceptron::Config perceptron;
    int horizon = 1;

    static Config read(ConfigReader& reader);
  };
  MlpHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec);

  Perceptron perceptron_;
};

}  // namespace tandem::policy
