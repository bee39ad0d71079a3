#include "policy_runtime/policies/observation_tokens.h"

#include <algorithm>
#include <numeric>

namespace tandem::policy {

ObservationTokens ObservationTokens::read(ConfigReader& reader, int observation_size) {
  ObservationTokens tokens;
  for (ConfigReader& token : reader.objects("tokens", 1, kMost)) {
    token.name("name");
    tokens.sizes_.push_back(token.integer("size", 1, observation_size));
    token.finish();
  }
  const int sum = std::accumulate(tokens.sizes_.begin(), tokens.sizes_.end(), 0);
  if (sum != observation_size) {
    reader.refuse("has tokens of " + std::to_string(sum) + " numbers; the observation has " +
                  std::to_string(observation_size) + ".");
  }
  return tokens;
}

std::vector<Encoder::Token> ObservationTokens::of_encoder(const std::string& prefix) const {
  std::vector<Encoder::Token> tokens;
  for (int i = 0; i < count(); ++i) {
    tokens.push_back({prefix + ".tokens." + std::to_string(i), sizes_[i]});
  }
  return tokens;
}

// one slice
std::size_t ObservationTokens::workspace_size() const noexcept {
  return padded(*std::max_element(sizes_.begin(), sizes_.end()));
}

void ObservationTokens::embed(const Kernels& kernels, const Encoder& encoder, int first,
                              const float* x, Rows rows, float* workspace) const noexcept {
  for (int i = 0; i < count(); ++i) {
    std::fill(std::copy_n(x, sizes_[i], workspace), workspace + padded(sizes_[i]), 0.0f);
    encoder.embed(kernels, first + i, workspace, rows);
    x += sizes_[i];
  }
}

}  // namespace tandem::policy
