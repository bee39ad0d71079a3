#include "policy_runtime/layers/projection.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "policy_runtime/file/safetensors.h"

namespace tandem::policy {
namespace {

bool is_power_of_two(float factor) {
  int exponent = 0;
  return std::frexp(factor, &exponent) == 0.5f;
}

// The maps one under the other: bfloat16 when all of them are.
WeightMatrix stack(SafetensorsFile& file, const std::vector<std::string>& prefixes, int in, int out,
                   float factor, float& factor_left) {
  std::vector<float> rows;
  bool half = true;
  for (const std::string& prefix : prefixes) {
    const std::vector<float> W = file.take(prefix + ".weight", {out, in});
    rows.insert(rows.end(), W.begin(), W.end());
    half = half && file.is_bfloat16(prefix + ".weight");
  }
  if (half && !is_power_of_two(factor)) {
    factor_left = factor;
  } else {
    std::for_each_n(rows.begin(), std::size_t(out) * in, [&](float& w) { w *= factor; });
  }
  return {rows, static_cast<int>(prefixes.size()) * out, in,
          half ? Precision::kBfloat16 : Precision::kFloat32};
}

}  // namespace

Projection::Projection(SafetensorsFile& file, const std::vector<std::string>& prefixes, int in,
                       int out, float factor)
    : part_(out),
      W_(stack(file, prefixes, in, out, factor, factor_)),
      bias_(W_.rows()),
      zero_(W_.rows()) {
  float* next = bias_.data();
  for (const std::string& prefix : prefixes) {
    const std::vector<float> b = file.take(prefix + ".bias", {out});
    next = std::copy(b.begin(), b.end(), next);
  }
  if (factor_ == 1.0f) std::for_each_n(bias_.data(), out, [&](float& b) { b *= factor; });
}

void Projection::add_positions(ConstRows positions, int n, int parts) {
  bias_stride_ = padded(out());
  AlignedBuffer rows(bias_stride_ * n);
  kernels().gemm(W_.packed(), {bias_.data(), 0}, positions, n, {rows.data(), bias_stride_});
  for (int i = 0; i < n; ++i) {
    const int with = parts * part_;
    std::copy(bias_.data() + with, bias_.data() + out(), rows.data() + i * bias_stride_ + with);
  }
  bias_ = std::move(rows);
}

void Projection::forward(const Kernels& kernels, ConstRows X, int n, Rows Y,
                         int first) const noexcept {
  multiply(kernels, {bias_.data() + first * bias_stride_, bias_stride_}, X, n, Y);
}

void Projection::multiply(const Kernels& kernels, ConstRows X, int n, Rows Y) const noexcept {
  multiply(kernels, {zero_.data(), 0}, X, n, Y);
}

void Projection::multiply(const Kernels& kernels, ConstRows bias, ConstRows X, int n,
                          Rows Y) const noexcept {
  kernels.gemm(W_.packed(), bias, X, n, Y);
  if (factor_ == 1.0f) return;
  for (int i = 0; i < n; ++i) {
    std::for_each_n(Y.data + i * Y.stride, part_, [this](float& y) { y *= factor_; });
  }
}

}  // namespace tandem::policy
