#pragma once

#include <string>
#include <vector>

#include "policy_runtime/layers/embedding.h"
#include "policy_runtime/layers/transformer.h"

namespace tandem::policy {

/// Tokens -> memory: what the queries of a policy look at. The first tokens are made of a few
/// numbers each (a latent, slices of the observation), the others are given (image features).
///
/// One evaluation is embed() or embed_zeros() for every token made of numbers, with features
/// written into the other rows and embed_features(), then forward(). Rows stay as they are: whoever
/// changes one token embeds that one again.
class Encoder {
 public:
  struct Token {
    std::string tensor;  ///< W = TENSOR.weight (d, size), b = TENSOR.bias (d)
    int size;
  };

  /// Takes the tensors of tokens and PREFIX.{0..layers-1}.*.
  /// @param positions of all tokens
  /// @throws PolicyError
  Encoder(SafetensorsFile& file, const std::string& prefix, const TransformerConfig& config,
          int layers, const std::vector<Token>& tokens, const PositionRows& positions);

  int tokens() const noexcept { return tokens_; }  ///< T

  /// Length of a row that forward() begins with; the token's x (d) lies at its beginning.
  std::size_t row_stride() const noexcept { return Embedding::width(d_, first_projection()); }

  /// Row of a token from its numbers v, padded. Real-time.
  void embed(const Kernels& kernels, int token, const float* v, Rows rows) const noexcept;
  /// The same for v = 0. Real-time.
  void embed_zeros(int token, Rows rows) const noexcept;
  /// Completes the rows of the tokens that are not made of numbers. Real-time.
  void embed_features(const Kernels& kernels, Rows rows) const noexcept;

  std::size_t workspace_size() const noexcept;

  /// Rows (T, row_stride()) -> memory (T, d). Real-time.
  void forward(const Kernels& kernels, ConstRows rows, Rows memory,
               float* workspace) const noexcept;

 private:
  const Projection* first_projection() const noexcept {
    return layers_.empty() ? nullptr : &layers_.front().projection();
  }

  int tokens_, d_;
  std::vector<EncoderLayer> layers_;
  std::vector<Embedding> embeddings_;
};

}  // namespace tandem::policy
