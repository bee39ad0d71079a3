#include "policy_runtime/policies/gaussian.h"

#include "policy_runtime/scratch.h"

namespace tandem::policy {

GaussianHead::Config GaussianHead::Config::read(ConfigReader& reader) {
  const Config config{Perceptron::Config::read(reader), TanhNormal::read(reader),
                      reader.integer("horizon", 1, kMaxHorizon)};
  reader.choice("output", {"tanh"});
  reader.finish();
  return config;
}

GaussianHead::GaussianHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec)
    : GaussianHead(file, Config::read(config), spec) {}

GaussianHead::GaussianHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec)
    : Head(config.horizon, spec.action_size),
      perceptron_(file, spec.prefix, config.perceptron, spec.observation_size, 2 * chunk_size(),
                  Activation::kIdentity),
      normal_(config.normal) {}

// mean and log_std | the perceptron's own
std::size_t GaussianHead::workspace_size(int) const noexcept {
  return padded(2 * chunk_size()) + perceptron_.workspace_size(1);
}

// Every sample has the same mean and deviation.
void GaussianHead::forward(const HeadInput& input, int samples, float* chunks,
                           float* workspace) const noexcept {
  const int n = chunk_size();
  Scratch scratch(workspace);
  float* parameters = scratch.take(2 * n);
  perceptron_.forward(kernels(), {input.x, 0}, 1, {parameters, 0}, scratch.take(0));
  normal_.to_deviations(parameters, n);
  for (int i = 0; i < samples; ++i) {
    normal_.sample(kernels(), parameters, n, input.noise + std::size_t(i) * n,
                   chunks + i * padded(n));
  }
}

}  // namespace tandem::policy
