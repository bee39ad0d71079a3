#include "policy_runtime/policies/critic_ensemble.h"

#include <cmath>

#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

std::vector<std::string> member_names(int members) {
  std::vector<std::string> names;
  for (int m = 0; m < members; ++m) names.push_back("critic." + std::to_string(m));
  return names;
}

}  // namespace

CriticEnsemble::Config CriticEnsemble::Config::read(ConfigReader reader) {
  constexpr int kMaxMembers = 32;
  constexpr Aggregate kOf[] = {Aggregate::kMean, Aggregate::kMin};
  const Config config{Perceptron::Config::read(reader), reader.integer("members", 1, kMaxMembers),
                      kOf[reader.choice("aggregate", {"mean", "min"})]};
  reader.finish();
  return config;
}

CriticEnsemble::CriticEnsemble(SafetensorsFile& file, const Config& config, int observation_size,
                               int chunk_size)
    : chunk_stride_(padded(chunk_size)),
      members_(config.members),
      aggregate_(config.aggregate),
      perceptron_(file, member_names(config.members), config.perceptron,
                  {observation_size, chunk_size}, 1) {}

// the observation's part of the first layers | the members' values | the perceptrons' own
std::size_t CriticEnsemble::workspace_size(int n) const noexcept {
  return perceptron_.first().width() + std::size_t(n) * members_ * padded(1) +
         perceptron_.workspace_size(n);
}

void CriticEnsemble::forward(const float* x, const float* chunks, int n, float* scores,
                             float* workspace) const noexcept {
  const std::size_t stride = members_ * padded(1);
  Scratch scratch(workspace);
  float* base = scratch.take(perceptron_.first().width());
  float* values = scratch.take(n * stride);
  perceptron_.first().observe(kernels(), x, base);
  perceptron_.forward(kernels(), base, {chunks, chunk_stride_}, n, {values, stride},
                      scratch.take(0));
  for (int row = 0; row < n; ++row) scores[row] = aggregate(values + row * stride);
}

// values: one of each member, padded(1) apart.
float CriticEnsemble::aggregate(const float* values) const noexcept {
  float sum = values[0], least = values[0];
  for (int m = 1; m < members_; ++m) {
    const float value = values[m * padded(1)];
    sum += value;
    if (value < least || std::isnan(value)) least = value;
  }
  return aggregate_ == Aggregate::kMean ? sum / float(members_) : least;
}

}  // namespace tandem::policy
