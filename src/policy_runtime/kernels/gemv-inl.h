// One vector through a matrix.
#if defined(TANDEM_POLICY_KERNELS_GEMV_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef TANDEM_POLICY_KERNELS_GEMV_INL_H_
#undef TANDEM_POLICY_KERNELS_GEMV_INL_H_
#else
#define TANDEM_POLICY_KERNELS_GEMV_INL_H_
#endif

#include <algorithm>

#include "policy_runtime/kernels/vector-inl.h"

HWY_BEFORE_NAMESPACE();
namespace tandem::policy {
namespace HWY_NAMESPACE {

// kWidth registers of rows against all columns. Columns 0, 4, 8.. go to the first sum, 1, 5, 9.. to
// the second and so on: four chains of additions run at once, and the order is the same at any
// register width.
template <int kWidth, typename Weight>
HWY_INLINE void GemvRows(const Weight* HWY_RESTRICT w, int padded_columns,
                         const float* HWY_RESTRICT b, const float* HWY_RESTRICT x,
                         float* HWY_RESTRICT y) {
  constexpr int kPhases = PackedMatrix::kPhases;
  V sum[kPhases][kWidth];
  HWY_UNROLL(2)
  for (int i = 0; i < kWidth; ++i) {
    sum[0][i] = hn::Load(d, b + i * kLanes);
    HWY_UNROLL(4)
    for (int phase = 1; phase < kPhases; ++phase) sum[phase][i] = hn::Zero(d);
  }
  for (int column = 0; column < padded_columns; column += kPhases, w += kPhases * kPadding) {
    HWY_UNROLL(4)
    for (int phase = 0; phase < kPhases; ++phase) {
      const V value = hn::Set(d, x[column + phase]);
      HWY_UNROLL(2)
      for (int i = 0; i < kWidth; ++i) {
        const V weights = LoadWeights(w + phase * kPadding + i * kLanes);
        sum[phase][i] = hn::MulAdd(weights, value, sum[phase][i]);
      }
    }
  }
  HWY_UNROLL(2)
  for (int i = 0; i < kWidth; ++i) {
    const V even = hn::Add(sum[0][i], sum[1][i]), odd = hn::Add(sum[2][i], sum[3][i]);
    hn::Store(hn::Add(even, odd), d, y + i * kLanes);
  }
}

template <typename Weight>
HWY_INLINE void GemvOf(const Weight* w, const PackedMatrix& W, const float* b, const float* x,
                       float* y) {
  constexpr int kWidth = std::min(2, kRegisters);
  const int columns = W.padded_columns();
  for (int row = 0; row < W.rows; row += kPadding, w += std::size_t(columns) * kPadding) {
    for (int lane = 0; lane < kPadding; lane += kWidth * kLanes) {
      GemvRows<kWidth>(w + lane, columns, b + row + lane, x, y + row + lane);
    }
  }
}

void Gemv(const PackedMatrix& W, const float* b, const float* x, float* y) {
  if (W.precision == Precision::kFloat32) return GemvOf(W.data, W, b, x, y);
  GemvOf(W.data_bf16, W, b, x, y);
}

}  // namespace HWY_NAMESPACE
}  // namespace tandem::policy
HWY_AFTER_NAMESPACE();

#endif
