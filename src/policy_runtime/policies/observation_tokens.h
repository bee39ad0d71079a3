#pragma once

#include <string>
#include <vector>

#include "policy_runtime/layers/encoder.h"

namespace tandem::policy {

/// The observation cut into consecutive slices, one token of a transformer each.
class ObservationTokens {
 public:
  static constexpr int kMost = 64;

  /// Reads tokens ([{"name", "size"}, ...]); the sizes add up to observation_size.
  /// @throws PolicyError
  static ObservationTokens read(ConfigReader& reader, int observation_size);

  int count() const noexcept { return static_cast<int>(sizes_.size()); }

  /// What the encoder is to load: PREFIX.tokens.{i}.
  std::vector<Encoder::Token> of_encoder(const std::string& prefix) const;

  std::size_t workspace_size() const noexcept;

  /// x (O) -> the encoder's rows of the tokens first, first + 1, ... Real-time.
  void embed(const Kernels& kernels, const Encoder& encoder, int first, const float* x, Rows rows,
             float* workspace) const noexcept;

 private:
  std::vector<int> sizes_;
};

}  // namespace tandem::policy
