#pragma once

#include <string>

#include "policy_runtime/layers/dense.h"
#include "policy_runtime/layers/projection.h"

namespace tandem::policy {

/// Takes PREFIX.scale and PREFIX.offset (n); epsilon 1e-5 as in PyTorch. @throws PolicyError
LayerNorm take_layer_norm(SafetensorsFile& file, const std::string& prefix, int n);

/// y = norm(y + x) for n rows: how every part of a post-norm transformer ends. Real-time.
void add_and_normalise(const Kernels& kernels, const LayerNorm& norm, ConstRows X, int n, Rows Y);

/// Tokens look at each other: y = norm(x + W_o attention(W_q (x + p), W_k (x + p), W_v x)), where
/// attention(q, k, v) = softmax(q k' / sqrt(d / heads)) v, head by head.
class SelfAttention {
 public:
  /// Takes PREFIX.{query,key,value,output}.weight (d, d) and .bias (d), and NORM.scale and .offset.
  /// @param positions p (tokens, d)
  /// @throws PolicyError
  SelfAttention(SafetensorsFile& file, const std::string& prefix, const std::string& norm, int d,
                int heads, ConstRows positions, int tokens);

  /// x -> q, k, v side by side (tokens, 3 d); q carries 1 / sqrt(d / heads) already.
  const Projection& projection() const noexcept { return projection_; }

  /// Floats of scratch for so many samples.
  std::size_t workspace_size(int samples) const noexcept;

  /// X (samples tokens, d) and its QKV (samples tokens, 3 d) -> Y (samples tokens, d). Every sample
  /// looks at itself only. Real-time.
  void forward(const Kernels& kernels, ConstRows X, ConstRows QKV, int samples, Rows Y,
               float* workspace) const noexcept;

 private:
  AttentionShape shape_;
  Projection projection_;
  Dense output_;
  LayerNorm norm_;
};

/// Queries look at a memory: y = norm(x + W_o attention(W_q (x + p), W_k (m + s), W_v m)).
class CrossAttention {
 public:
  /// Takes the same tensors as SelfAttention.
  /// @param positions p (queries, d)
  /// @param memory_positions s (tokens, d)
  /// @throws PolicyError
  CrossAttention(SafetensorsFile& file, const std::string& prefix, const std::string& norm, int d,
                 int heads, ConstRows positions, int queries, ConstRows memory_positions,
                 int tokens);

  /// x (queries, d) -> q (queries, d), which carries 1 / sqrt(d / heads) already.
  const Projection& query_projection() const noexcept { return query_; }
  /// m (tokens, d) -> k, v side by side (tokens, 2 d).
  const Projection& memory_projection() const noexcept { return memory_; }

  /// Floats of scratch for so many samples.
  std::size_t workspace_size(int samples) const noexcept;

  /// X and its Q (samples queries, d) and the memory's KV (tokens, 2 d), the same for all samples
  /// -> Y (samples queries, d). Real-time.
  void forward(const Kernels& kernels, ConstRows X, ConstRows Q, ConstRows KV, int samples, Rows Y,
               float* workspace) const noexcept;

 private:
  AttentionShape shape_;
  Projection query_;
  Projection memory_;
  Dense output_;
  LayerNorm norm_;
};

}  // namespace tandem::policy
