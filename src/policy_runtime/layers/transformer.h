#pragma once

#include <string>
#include <vector>

#include "policy_runtime/file/config_reader.h"
#include "policy_runtime/layers/attention.h"

namespace tandem::policy {

inline constexpr int kMaxLayers = 16;  ///< of an encoder, of a decoder

/// The sizes that all layers of a transformer share.
struct TransformerConfig {
  int model_size = 1;  ///< d
  int heads = 1;       ///< divides d
  int feedforward = 1;
  Activation activation = Activation::kRelu;

  /// Reads model_size, heads, feedforward and activation (relu or gelu). @throws PolicyError
  static TransformerConfig read(ConfigReader& reader);
};

/// Positions that a transformer adds to its tokens: (count, d), each row padded.
class PositionRows {
 public:
  /// @param row_major (count, d)
  PositionRows(const std::vector<float>& row_major, int count, int d);

  int count() const noexcept { return count_; }
  int d() const noexcept { return d_; }
  operator ConstRows() const { return {rows_.data(), padded(d_)}; }  // NOLINT: meant to convert

 private:
  AlignedBuffer rows_;
  int count_, d_;
};

/// y = norm(x + W2 act(W1 x + b1) + b2), row by row.
class FeedForward {
 public:
  /// Takes PREFIX.feedforward1.weight (ff, d) .bias, .feedforward2.weight (d, ff) .bias, and
  /// NORM.scale and .offset. @throws PolicyError
  FeedForward(SafetensorsFile& file, const std::string& prefix, const std::string& norm,
              const TransformerConfig& config);

  std::size_t workspace_size(int n) const noexcept { return n * padded(first_.out()); }

  /// X (n, d) -> Y (n, d), not overlapping. Real-time.
  void forward(const Kernels& kernels, ConstRows X, int n, Rows Y, float* workspace) const noexcept;

 private:
  Dense first_, second_;
  LayerNorm norm_;
};

/// Post-norm encoder layer: self-attention, then feed-forward.
class EncoderLayer {
 public:
  /// Takes PREFIX.attention.*, .norm1, .feedforward1, .feedforward2, .norm2.
  /// @param positions (tokens, d), added to queries and keys
  /// @throws PolicyError
  EncoderLayer(SafetensorsFile& file, const std::string& prefix, const TransformerConfig& config,
               const PositionRows& positions);

  const Projection& projection() const noexcept { return attention_.projection(); }
  std::size_t workspace_size() const noexcept;

  /// X (tokens, d) and its projection QKV (tokens, 3 d) -> Y (tokens, d). Y may be X. Real-time.
  void forward(const Kernels& kernels, ConstRows X, ConstRows QKV, Rows Y,
               float* workspace) const noexcept;

 private:
  int tokens_, d_;
  SelfAttention attention_;
  FeedForward feedforward_;
};

/// Post-norm decoder layer: self-attention among the queries, attention to the memory,
/// feed-forward.
class DecoderLayer {
 public:
  /// Takes PREFIX.self_attention.*, .norm1, .cross_attention.*, .norm2, .feedforward1,
  /// .feedforward2, .norm3.
  /// @param positions (queries, d), added to the queries and, among themselves, to the keys
  /// @param memory_positions (tokens, d), added to the keys of the memory
  /// @throws PolicyError
  DecoderLayer(SafetensorsFile& file, const std::string& prefix, const TransformerConfig& config,
               const PositionRows& positions, const PositionRows& memory_positions);

  const Projection& projection() const noexcept { return self_.projection(); }
  const Projection& memory_projection() const noexcept { return cross_.memory_projection(); }
  std::size_t workspace_size(int samples) const noexcept;

  /// X (samples queries, d), its projection QKV (samples queries, 3 d) and the memory's projection
  /// KV (tokens, 2 d) -> Y (samples queries, d). Y may be X. Real-time.
  void forward(const Kernels& kernels, ConstRows X, ConstRows QKV, ConstRows KV, int samples,
               Rows Y, float* workspace) const noexcept;

 private:
  int queries_, d_;
  SelfAttention self_;
  CrossAttention cross_;
  FeedForward feedforward_;
};

/// The decoder layer whose input is zeros, whatever the policy sees: its self-attention and its
/// queries to the memory are computed once, when it is loaded.
class FirstDecoderLayer {
 public:
  /// Takes the same tensors as DecoderLayer. @throws PolicyError
  FirstDecoderLayer(SafetensorsFile& file, const std::string& prefix,
                    const TransformerConfig& config, const PositionRows& positions,
                    const PositionRows& memory_positions);

  const Projection& memory_projection() const noexcept { return cross_.memory_projection(); }
  std::size_t workspace_size() const noexcept;

  /// The memory's projection KV (tokens, 2 d) -> Y (queries, d). Real-time.
  void forward(const Kernels& kernels, ConstRows KV, Rows Y, float* workspace) const noexcept;

 private:
  int queries_, d_;
  AlignedBuffer x_;  // (queries, d): norm1 of the self-attention
  CrossAttention cross_;
  AlignedBuffer q_;  // (queries, d): what they ask the memory
  FeedForward feedforward_;
};

}  // namespace tandem::policy
