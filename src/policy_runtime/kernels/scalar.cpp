#include <algorithm>
#include <cmath>

#include "policy_runtime/kernels/kernels.h"

namespace tandem::policy {
namespace {

float element(const PackedMatrix& W, int row, int column) {
  const int panel = row / kPadding;
  return W.data[(std::size_t(panel) * W.padded_columns() + column) * kPadding + row % kPadding];
}

void gemv(const PackedMatrix& W, const float* b, const float* x, float* y) {
  for (int row = 0; row < W.rows; ++row) {
    float sum = b[row];
    for (int column = 0; column < W.columns; ++column) sum += element(W, row, column) * x[column];
    y[row] = sum;
  }
  std::fill(y + W.rows, y + padded(W.rows), 0.0f);
}

void layer_norm(const float* scale, const float* offset, float* y, int n) {
  double mean = 0.0;
  for (int i = 0; i < n; ++i) mean += y[i];
  mean /= n;
  double variance = 0.0;
  for (int i = 0; i < n; ++i) variance += (y[i] - mean) * (y[i] - mean);
  variance /= n;
  const double inverse = 1.0 / std::sqrt(variance + 1e-6);
  for (int i = 0; i < n; ++i) y[i] = float((y[i] - mean) * inverse) * scale[i] + offset[i];
}

float apply(Activation f, float x) {
  constexpr float kSqrtTwoOverPi = 0.7978845608f;
  switch (f) {
    case Activation::kRelu:
      return std::max(x, 0.0f);
    case Activation::kTanh:
      return std::tanh(x);
    case Activation::kGelu:
      return 0.5f * x * (1.0f + std::tanh(kSqrtTwoOverPi * (x + 0.044715f * x * x * x)));
    case Activation::kIdentity:
      break;
  }
  return x;
}

void activate(Activation f, float* y, int n) {
  for (int i = 0; i < n; ++i) y[i] = apply(f, y[i]);
}

}  // namespace

const Kernels& scalar_kernels() {
  static constexpr Kernels kTable = {"scalar", gemv, layer_norm, activate};
  return kTable;
}

}  // namespace tandem::policy
