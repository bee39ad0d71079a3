#include "policy_runtime/layers/attention.h"

#include <algorithm>
#include <cmath>

#include "policy_runtime/layers/add.h"
#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

constexpr float kEpsilon = 1e-5f;

float query_factor(int d, int heads) {
  return static_cast<float>(1.0 / std::sqrt(static_cast<double>(d / heads)));
}

AttentionShape with_samples(AttentionShape shape, int samples) {
  shape.n_queries *= samples;
  return shape;
}

// norm(x + W_o attended) -> Y. Attention leaves the padding of its result alone; gemm wants zeros.
void finish(const Kernels& kernels, const Dense& output, const LayerNorm& norm, ConstRows X,
            Rows attended, int n, Rows Y) {
  for (int i = 0; i < n; ++i) {
    float* row = attended.data + i * attended.stride;
    std::fill(row + norm.n, row + attended.stride, 0.0f);
  }
  output.forward(kernels, attended, n, Y);
  add_and_normalise(kernels, norm, X, n, Y);
}

}  // namespace

LayerNorm take_layer_norm(SafetensorsFile& file, const std::string& prefix, int n) {
  return {take_vector(file, prefix + ".scale", n), take_vector(file, prefix + ".offset", n),
          kEpsilon, n};
}

void add_and_normalise(const Kernels& kernels, const LayerNorm& norm, ConstRows X, int n, Rows Y) {
  for (int i = 0; i < n; ++i) {
    float* y = Y.data + i * Y.stride;
    add(X.data + i * X.stride, norm.n, y);
    norm.forward(kernels, y);
  }
}

SelfAttention::SelfAttention(SafetensorsFile& file, const std::string& prefix,
                             const std::string& norm, int d, int heads, ConstRows positions,
                             int tokens)
    : shape_{tokens, tokens, heads, d / heads},
      projection_(file, {prefix + ".query", prefix + ".key", prefix + ".value"}, d, d,
                  query_factor(d, heads)),
      output_(file, prefix + ".output", d, d, false, Activation::kIdentity),
      norm_(take_layer_norm(file, norm, d)) {
  projection_.add_positions(positions, tokens, 2);
}

// attended | the kernel's own
std::size_t SelfAttention::workspace_size(int samples) const noexcept {
  return samples * shape_.n_queries * padded(norm_.n) + padded(shape_.scratch());
}

void SelfAttention::forward(const Kernels& kernels, ConstRows X, ConstRows QKV, int samples, Rows Y,
                            float* workspace) const noexcept {
  Scratch scratch(workspace);
  const int d = norm_.n, tokens = shape_.n_queries;
  const std::size_t stride = padded(d);
  const Rows attended{scratch.take(samples * tokens * stride), stride};
  float* rest = scratch.take(shape_.scratch());
  for (int sample = 0; sample < samples; ++sample) {
    const float* qkv = QKV.data + sample * tokens * QKV.stride;
    kernels.attention(shape_, {qkv, QKV.stride}, {qkv + d, QKV.stride}, {qkv + 2 * d, QKV.stride},
                      {attended.data + sample * tokens * stride, stride}, rest);
  }
  finish(kernels, output_, norm_, X, attended, samples * tokens, Y);
}

CrossAttention::CrossAttention(SafetensorsFile& file, const std::string& prefix,
                               const std::string& norm, int d, int heads, ConstRows positions,
                               int queries, ConstRows memory_positions, int tokens)
    : shape_{queries, tokens, heads, d / heads},
      query_(file, {prefix + ".query"}, d, d, query_factor(d, heads)),
      memory_(file, {prefix + ".key", prefix + ".value"}, d, d),
      output_(file, prefix + ".output", d, d, false, Activation::kIdentity),
      norm_(take_layer_norm(file, norm, d)) {
  query_.add_positions(positions, queries, 1);
  memory_.add_positions(memory_positions, tokens, 1);
}

// attended | the kernel's own
std::size_t CrossAttention::workspace_size(int samples) const noexcept {
  const AttentionShape shape = with_samples(shape_, samples);
  return shape.n_queries * padded(norm_.n) + padded(shape.scratch());
}

void CrossAttention::forward(const Kernels& kernels, ConstRows X, ConstRows Q, ConstRows KV,
                             int samples, Rows Y, float* workspace) const noexcept {
  Scratch scratch(workspace);
  const AttentionShape shape = with_samples(shape_, samples);
  const std::size_t stride = padded(norm_.n);
  const Rows attended{scratch.take(shape.n_queries * stride), stride};
  kernels.attention(shape, Q, {KV.data, KV.stride}, {KV.data + norm_.n, KV.stride}, attended,
                    scratch.take(shape.scratch()));
  finish(kernels, output_, norm_, X, attended, shape.n_queries, Y);
}

}  // namespace tandem::policy
