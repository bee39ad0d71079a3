#include "policy_runtime/layers/dense.h"

namespace tandem::policy {

Dense::Dense(SafetensorsFile& file, const std::string& prefix, int in, int out, bool norm,
             Activation activation)
    : W_(WeightMatrix::take(file, prefix + ".weight", out, in)),
      b_(take_vector(file, prefix + ".bias", out)),
      activation_(activation) {
  if (norm) {
    norm_.emplace(LayerNorm{take_vector(file, prefix + ".norm_scale", out),
                            take_vector(file, prefix + ".norm_offset", out), kNormEpsilon, out});
  }
}

void Dense::forward(const Kernels& kernels, const float* x, float* y) const noexcept {
  kernels.gemv(W_.packed(), b_.data(), x, y);
  if (norm_) norm_->forward(kernels, y);
  kernels.activate(activation_, y, out());
}

void Dense::forward(const Kernels& kernels, ConstRows X, int n, Rows Y) const noexcept {
  kernels.gemm(W_.packed(), {b_.data(), 0}, X, n, Y);
  for (int row = 0; row < n; ++row) {
    float* y = Y.data + row * Y.stride;
    if (norm_) norm_->forward(kernels, y);
    kernels.activate(activation_, y, out());
  }
}

}  // namespace tandem::policy
