#pragma once

#include <memory>

#include "policy_runtime/policies/head.h"
#include "policy_runtime/policies/velocity_field.h"

namespace tandem::policy {

/// Flow policy: carries noise to a chunk along a velocity field, in K Euler steps.
///
///   a_0 = noise,  a_{k+1} = a_k + v(x, a_k, k / K) / K,  chunk = clip(a_K, -1, 1)
///
/// Config: field ("mlp" or "transformer"), horizon, steps (K), time_features, output ("clip") and
/// what the field needs, see PerceptronField and TransformerField.
class FlowHead final : public Head {
 public:
  FlowHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec);

  int noise_size() const noexcept override { return chunk_size(); }
  std::size_t workspace_size(int samples) const noexcept override;
  void forward(const HeadInput& input, int samples, float* chunks,
               float* workspace) const noexcept override;

 private:
  struct Config {
    bool transformer = false;  // the field; else an MLP
    int horizon = 1;
    int steps = 1;
    int time_features = 2;

    static Config read(ConfigReader& reader);
  };
  FlowHead(SafetensorsFile& file, ConfigReader& reader, const Config& config, const HeadSpec& spec);
  static std::unique_ptr<const VelocityField> load_field(SafetensorsFile& file,
                                                         ConfigReader& reader, const Config& config,
                                                         const HeadSpec& spec);

  int steps_;  // K
  std::unique_ptr<const VelocityField> field_;
};

}  // namespace tandem::policy
