#include "policy_runtime/policies/mlp.h"

#include <algorithm>

namespace tandem::policy {

MlpHead::Config MlpHead::Config::read(ConfigReader& reader) {
  const Config config{Perceptron::Config::read(reader), reader.integer("horizon", 1, kMaxHorizon)};
  reader.choice("output", {"tanh"});
  reader.finish();
  return config;
}

MlpHead::MlpHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec)
    : MlpHead(file, Config::read(config), spec) {}

MlpHead::MlpHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec)
    : Head(config.horizon, spec.action_size),
      perceptron_(file, spec.prefix, config.perceptron, spec.observation_size, chunk_size(),
                  Activation::kTanh) {}

std::size_t MlpHead::workspace_size(int) const noexcept { return perceptron_.workspace_size(1); }

void MlpHead::forward(const HeadInput& input, int samples, float* chunks,
                      float* workspace) const noexcept {
  const std::size_t stride = padded(chunk_size());
  perceptron_.forward(kernels(), {input.x, 0}, 1, {chunks, stride}, workspace);
  for (int i = 1; i < samples; ++i) std::copy_n(chunks, stride, chunks + i * stride);
}

}  // namespace tandem::policy
