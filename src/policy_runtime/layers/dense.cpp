#include "policy_runtime/layers/dense.h"

#include <algorithm>

#include "policy_runtime/file/safetensors.h"

namespace tandem::policy {
namespace {

// Copies a vector (n) to the arena and moves the arena's pointer behind it.
const float* take_vector(SafetensorsFile& file, const std::string& name, int n, float*& arena) {
  const std::vector<float> values = file.take(name, {n});
  const float* begin = arena;
  std::copy(values.begin(), values.end(), arena);
  arena += padded(n);
  return begin;
}

}  // namespace

Dense::Dense(int in, int out, bool norm, Activation activation)
    : in(in), out(out), norm(norm), activation(activation), W{nullptr, out, in} {}

std::size_t Dense::size() const { return padded(W.size()) + padded(out) * (norm ? 3 : 1); }

float* Dense::load(SafetensorsFile& file, const std::string& prefix, float* arena) {
  const std::vector<float> weight = file.take(prefix + ".weight", {out, in});
  pack(weight.data(), W, arena);
  arena += padded(W.size());
  b = take_vector(file, prefix + ".bias", out, arena);
  if (norm) {
    norm_scale = take_vector(file, prefix + ".norm_scale", out, arena);
    norm_offset = take_vector(file, prefix + ".norm_offset", out, arena);
  }
  return arena;
}

void Dense::forward(const Kernels& kernels, const float* x, float* y) const noexcept {
  kernels.gemv(W, b, x, y);
  if (norm) kernels.layer_norm(norm_scale, norm_offset, y, out);
  kernels.activate(activation, y, out);
}

}  // namespace tandem::policy
