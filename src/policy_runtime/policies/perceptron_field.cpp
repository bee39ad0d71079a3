#include "policy_runtime/policies/perceptron_field.h"

#include <utility>

#include "policy_runtime/scratch.h"

namespace tandem::policy {

PerceptronField::PerceptronField(SafetensorsFile& file, const std::string& prefix,
                                 const Perceptron::Config& config, int observation_size,
                                 int chunk_size, std::vector<std::vector<double>> phi)
    : perceptron_(file, {prefix}, config, {observation_size, chunk_size, std::move(phi)},
                  chunk_size) {}

// the observation's part of the first layer | with the time's | the perceptron's own
std::size_t PerceptronField::workspace_size(int samples) const noexcept {
  return 2 * perceptron_.first().width() + perceptron_.workspace_size(samples);
}

void PerceptronField::observe(const float* x, float* workspace) const noexcept {
  perceptron_.first().observe(kernels(), x, workspace);
}

void PerceptronField::velocity(int step, ConstRows A, int samples, Rows V,
                               float* workspace) const noexcept {
  Scratch scratch(workspace);
  const float* base = scratch.take(perceptron_.first().width());
  float* at_this_time = scratch.take(perceptron_.first().width());
  perceptron_.first().shift(base, step, at_this_time);
  perceptron_.forward(kernels(), at_this_time, A, samples, V, scratch.take(0));
}

}  // namespace tandem::policy
