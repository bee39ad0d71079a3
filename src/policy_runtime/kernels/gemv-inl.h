// One vector through a matrix.
#if defined(TANDEM_POLICY_KERNELS_GEMV_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef TANDEM_POLICY_KERNELS_GEMV_INL_H_
#undef TANDEM_POLICY_KERNELS_GEMV_INL_H_
#else
#define TANDEM_POLICY_KERNELS_GEMV_INL_H_
#endif

#include "policy_runtime/kernels/vector-inl.h"

HWY_BEFORE_NAMESPACE();
namespace tandem::policy {
namespace HWY_NAMESPACE {

// One register of rows of a panel against all columns. Columns 0, 4, 8.. go to the first sum, 1, 5,
// 9.. to the second and so on: four chains of additions run at once, and the order is the same at
// any register width.
template <int kRegisters>
HWY_INLINE void GemvRows(const float* HWY_RESTRICT w, int padded_columns,
                         const float* HWY_RESTRICT b, const float* HWY_RESTRICT x,
                         float* HWY_RESTRICT y) {
  constexpr int kSecond = (kRegisters - 1) * kLanes;  // where the second register of rows begins
  V a0 = hn::Load(d, b), a1 = hn::Zero(d), a2 = hn::Zero(d), a3 = hn::Zero(d);
  [[maybe_unused]] V c0 = hn::Load(d, b + kSecond), c1 = hn::Zero(d), c2 = hn::Zero(d),
                     c3 = hn::Zero(d);
  for (int column = 0; column < padded_columns; column += PackedMatrix::kPhases) {
    const V x0 = hn::Set(d, x[column]), x1 = hn::Set(d, x[column + 1]);
    const V x2 = hn::Set(d, x[column + 2]), x3 = hn::Set(d, x[column + 3]);
    a0 = hn::MulAdd(hn::Load(d, w), x0, a0);
    a1 = hn::MulAdd(hn::Load(d, w + kPadding), x1, a1);
    a2 = hn::MulAdd(hn::Load(d, w + 2 * kPadding), x2, a2);
    a3 = hn::MulAdd(hn::Load(d, w + 3 * kPadding), x3, a3);
    if constexpr (kRegisters == 2) {
      c0 = hn::MulAdd(hn::Load(d, w + kSecond), x0, c0);
      c1 = hn::MulAdd(hn::Load(d, w + kPadding + kSecond), x1, c1);
      c2 = hn::MulAdd(hn::Load(d, w + 2 * kPadding + kSecond), x2, c2);
      c3 = hn::MulAdd(hn::Load(d, w + 3 * kPadding + kSecond), x3, c3);
    }
    w += PackedMatrix::kPhases * kPadding;
  }
  hn::Store(hn::Add(hn::Add(a0, a1), hn::Add(a2, a3)), d, y);
  if constexpr (kRegisters == 2) {
    hn::Store(hn::Add(hn::Add(c0, c1), hn::Add(c2, c3)), d, y + kSecond);
  }
}

void Gemv(const PackedMatrix& W, const float* b, const float* x, float* y) {
  constexpr int kRegisters = kLanes < kPadding ? 2 : 1;
  const int columns = W.padded_columns();
  const float* panel = W.data;
  for (int row = 0; row < W.rows; row += kPadding, panel += std::size_t(columns) * kPadding) {
    for (int lane = 0; lane < kPadding; lane += kRegisters * kLanes) {
      GemvRows<kRegisters>(panel + lane, columns, b + row + lane, x, y + row + lane);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace tandem::policy
HWY_AFTER_NAMESPACE();

#endif
