#pragma once

#include <optional>
#include <string>

#include "policy_runtime/layers/weights.h"

namespace tandem::policy {

/// y = (x - mean) / sqrt(variance + epsilon) * scale + offset.
struct LayerNorm {
  AlignedBuffer scale;   ///< (n)
  AlignedBuffer offset;  ///< (n)
  float epsilon;
  int n;

  /// y (n) in place. Real-time.
  void forward(const Kernels& kernels, float* y) const noexcept {
    kernels.layer_norm(scale.data(), offset.data(), epsilon, y, n);
  }
};

/// y = act(norm(W x + b)), the norm optional.
class Dense {
 public:
  static constexpr float kNormEpsilon = 1e-6f;

  /// Takes PREFIX.weight (out, in), .bias (out) and, with norm, .norm_scale and .norm_offset (out).
  /// @throws PolicyError
  Dense(SafetensorsFile& file, const std::string& prefix, int in, int out, bool norm,
        Activation activation);

  int in() const noexcept { return W_.columns(); }
  int out() const noexcept { return W_.rows(); }

  /// x padded(in), y padded(out), not overlapping. Real-time.
  void forward(const Kernels& kernels, const float* x, float* y) const noexcept;

  /// n rows at once: X (n, in) -> Y (n, out). Real-time.
  void forward(const Kernels& kernels, ConstRows X, int n, Rows Y) const noexcept;

 private:
  WeightMatrix W_;
  AlignedBuffer b_;
  std::optional<LayerNorm> norm_;
  Activation activation_;
};

}  // namespace tandem::policy
