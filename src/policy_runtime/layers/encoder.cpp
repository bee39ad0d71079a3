#include "policy_runtime/layers/encoder.h"

#include <algorithm>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/scratch.h"

namespace tandem::policy {

Encoder::Encoder(SafetensorsFile& file, const std::string& prefix, const TransformerConfig& config,
                 int layers, const std::vector<Token>& tokens, const PositionRows& positions)
    : tokens_(positions.count()), d_(config.model_size) {
  for (int i = 0; i < layers; ++i) {
    layers_.emplace_back(file, prefix + "." + std::to_string(i), config, positions);
  }
  for (const Token& token : tokens) {
    const AlignedBuffer b = take_vector(file, token.tensor + ".bias", d_);
    embeddings_.emplace_back(file.take(token.tensor + ".weight", {d_, token.size}), d_, token.size,
                             ConstRows{b.data(), 0}, 1, first_projection(),
                             static_cast<int>(embeddings_.size()));
  }
}

void Encoder::embed(const Kernels& kernels, int token, const float* v, Rows rows) const noexcept {
  embeddings_[token].forward(kernels, {v, 0}, 1, {rows.data + token * rows.stride, rows.stride});
}

void Encoder::embed_zeros(int token, Rows rows) const noexcept {
  std::copy_n(embeddings_[token].of_zeros(), row_stride(), rows.data + token * rows.stride);
}

void Encoder::embed_features(const Kernels& kernels, Rows rows) const noexcept {
  const int first = static_cast<int>(embeddings_.size());
  if (layers_.empty() || first == tokens_) return;
  float* x = rows.data + first * rows.stride;
  first_projection()->forward(kernels, {x, rows.stride}, tokens_ - first,
                              {x + padded(d_), rows.stride}, first);
}

// projection of all layers but the first | a layer's own
std::size_t Encoder::workspace_size() const noexcept {
  if (layers_.empty()) return 0;
  return tokens_ * padded(3 * d_) + layers_.front().workspace_size();
}

void Encoder::forward(const Kernels& kernels, ConstRows rows, Rows memory,
                      float* workspace) const noexcept {
  if (layers_.empty()) {
    for (int i = 0; i < tokens_; ++i) {
      std::copy_n(rows.data + i * rows.stride, padded(d_), memory.data + i * memory.stride);
    }
    return;
  }
  Scratch scratch(workspace);
  const Rows QKV{scratch.take(tokens_ * padded(3 * d_)), padded(3 * d_)};
  float* rest = scratch.take(0);
  layers_.front().forward(kernels, rows, {rows.data + padded(d_), rows.stride}, memory, rest);
  for (std::size_t i = 1; i < layers_.size(); ++i) {
    layers_[i].projection().forward(kernels, memory, tokens_, QKV);
    layers_[i].forward(kernels, memory, QKV, memory, rest);
  }
}

}  // namespace tandem::policy
