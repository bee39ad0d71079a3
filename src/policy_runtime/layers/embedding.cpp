#include "policy_runtime/layers/embedding.h"

#include <algorithm>

namespace tandem::policy {
namespace {

void copy_rows(ConstRows X, int n, int d, Rows Y) {
  for (int i = 0; i < n; ++i) std::copy_n(X.data + i * X.stride, d, Y.data + i * Y.stride);
}

}  // namespace

AlignedBuffer Embedding::rows(ConstRows X, int n, int d, const Projection* projection) {
  const std::size_t stride = width(d, projection);
  AlignedBuffer made(n * stride);
  copy_rows(X, n, d, {made.data(), stride});
  if (projection) projection->multiply(kernels(), X, n, {made.data() + padded(d), stride});
  return made;
}

// The columns of E are tokens, too: their rows are the columns of the product.
WeightMatrix Embedding::compose(const std::vector<float>& E, int d, int in,
                                const Projection* projection) {
  const std::size_t stride = padded(d), out = width(d, projection);
  AlignedBuffer columns(in * stride);
  for (int row = 0; row < d; ++row) {
    for (int c = 0; c < in; ++c) columns.data()[c * stride + row] = E[std::size_t(row) * in + c];
  }
  const AlignedBuffer made = rows({columns.data(), stride}, in, d, projection);
  std::vector<float> matrix(out * in);
  for (std::size_t row = 0; row < out; ++row) {
    for (int c = 0; c < in; ++c) matrix[row * in + c] = made.data()[c * out + row];
  }
  return {matrix, static_cast<int>(out), in, Precision::kFloat32};
}

AlignedBuffer Embedding::offsets(ConstRows e, int n, int d, const Projection* projection,
                                 int first) {
  const std::size_t stride = width(d, projection);
  AlignedBuffer made(n * stride);
  copy_rows(e, n, d, {made.data(), stride});
  if (projection) projection->forward(kernels(), e, n, {made.data() + padded(d), stride}, first);
  return made;
}

Embedding::Embedding(const std::vector<float>& E, int d, int in, ConstRows e, int n,
                     const Projection* projection, int first)
    : n_(n), matrix_(compose(E, d, in, projection)), bias_(offsets(e, n, d, projection, first)) {}

void Embedding::forward(const Kernels& kernels, ConstRows V, int samples, Rows Y) const noexcept {
  const std::size_t stride = matrix_.rows();
  for (int sample = 0; sample < samples; ++sample) {
    kernels.gemm(matrix_.packed(), {bias_.data(), stride},
                 {V.data + sample * n_ * V.stride, V.stride}, n_,
                 {Y.data + sample * n_ * Y.stride, Y.stride});
  }
}

}  // namespace tandem::policy
