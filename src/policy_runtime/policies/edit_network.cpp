#include "policy_runtime/policies/edit_network.h"

#include <algorithm>

#include "policy_runtime/scratch.h"

namespace tandem::policy {

EditNetwork::Config EditNetwork::Config::read(ConfigReader reader) {
  constexpr double kMaxScale = 2.0;  // from one end of an action's range to the other
  const Config config{Perceptron::Config::read(reader), TanhNormal::read(reader),
                      static_cast<float>(reader.number("scale", 0.0, kMaxScale))};
  reader.finish();
  return config;
}

EditNetwork::EditNetwork(SafetensorsFile& file, const Config& config, int observation_size,
                         int chunk_size)
    : chunk_size_(chunk_size),
      perceptron_(file, {"edit"}, config.perceptron, {observation_size, chunk_size},
                  2 * chunk_size),
      normal_(config.normal),
      scale_(config.scale) {}

// the observation's part of the first layer | mean and log_std | the perceptron's own
std::size_t EditNetwork::workspace_size(int n) const noexcept {
  return perceptron_.first().width() + n * padded(2 * chunk_size_) + perceptron_.workspace_size(n);
}

void EditNetwork::forward(const float* x, const float* noise, const float* chunks, int n,
                          float* edited, float* workspace) const noexcept {
  const std::size_t stride = padded(chunk_size_), parameters_stride = padded(2 * chunk_size_);
  Scratch scratch(workspace);
  float* base = scratch.take(perceptron_.first().width());
  float* parameters = scratch.take(n * parameters_stride);

  perceptron_.first().observe(kernels(), x, base);
  perceptron_.forward(kernels(), base, {chunks, stride}, n, {parameters, parameters_stride},
                      scratch.take(0));
  for (int row = 0; row < n; ++row) {
    const float* a = chunks + row * stride;
    float* out = edited + row * stride;
    normal_.to_deviations(parameters + row * parameters_stride, chunk_size_);
    normal_.sample(kernels(), parameters + row * parameters_stride, chunk_size_,
                   noise + std::size_t(row) * chunk_size_, out);
    for (int i = 0; i < chunk_size_; ++i) out[i] = std::clamp(a[i] + scale_ * out[i], -1.0f, 1.0f);
  }
}

}  // namespace tandem::policy
