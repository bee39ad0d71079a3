// Highway compiles this file once per instruction set (foreach_target.h) and HWY_DYNAMIC_DISPATCH
// finds them again.
#include <algorithm>
#include <cmath>
#include <string_view>
#include <vector>

#include "policy_runtime/kernels/kernels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "policy_runtime/kernels/simd.cpp"
// foreach_target.h must come first and math-inl.h last
// clang-format off
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
#include <hwy/contrib/math/math-inl.h>
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace tandem::policy {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr hn::CappedTag<float, kPadding> d;
using V = hn::Vec<decltype(d)>;
constexpr int kLanes = static_cast<int>(hn::MaxLanes(d));  // divides kPadding

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

// Sum of f(y[i]) over the first n: 16 partial sums at any register width, then those from left to
// right.
template <typename F>
HWY_INLINE float Sum(const float* y, int n, F f) {
  alignas(64) float partial[kPadding];
  for (int lane = 0; lane < kPadding; lane += kLanes) {
    V sum = hn::Zero(d);
    for (int i = lane; i < n; i += kPadding) {
      const auto inside = hn::FirstN(d, std::min(n - i, kLanes));
      sum = hn::Add(sum, hn::IfThenElseZero(inside, f(hn::Load(d, y + i))));
    }
    hn::Store(sum, d, partial + lane);
  }
  float total = 0.0f;
  for (const float value : partial) total += value;
  return total;
}

void LayerNorm(const float* scale, const float* offset, float epsilon, float* y, int n) {
  const V mean = hn::Set(d, Sum(y, n, [](V v) { return v; }) / float(n));
  const float variance = Sum(y, n,
                             [&](V v) {
                               const V centred = hn::Sub(v, mean);
                               return hn::Mul(centred, centred);
                             }) /
                         float(n);
  const V inverse = hn::Set(d, 1.0f / std::sqrt(variance + epsilon));
  for (int i = 0; i < n; i += kLanes) {
    // scale and offset are zero in the padding, so the result is too
    const V centred = hn::Mul(hn::Sub(hn::Load(d, y + i), mean), inverse);
    hn::Store(hn::MulAdd(centred, hn::Load(d, scale + i), hn::Load(d, offset + i)), d, y + i);
  }
}

template <typename F>
HWY_INLINE void ForEach(float* y, int n, F f) {
  for (int i = 0; i < n; i += kLanes) hn::Store(f(hn::Load(d, y + i)), d, y + i);
}

HWY_INLINE V Gelu(V x) {
  const V cubic = hn::Mul(hn::Set(d, 0.044715f), hn::Mul(x, hn::Mul(x, x)));
  const V inner = hn::Mul(hn::Set(d, 0.7978845608f), hn::Add(x, cubic));  // sqrt(2 / pi)
  return hn::Mul(hn::Mul(hn::Set(d, 0.5f), x), hn::Add(hn::Set(d, 1.0f), hn::Tanh(d, inner)));
}

// Every f maps 0 to 0, which keeps the padding zero.
void Activate(Activation f, float* y, int n) {
  switch (f) {
    case Activation::kRelu:
      return ForEach(y, n, [](V v) { return hn::Max(v, hn::Zero(d)); });
    case Activation::kTanh:
      return ForEach(y, n, [](V v) { return hn::Tanh(d, v); });
    case Activation::kGelu:
      return ForEach(y, n, [](V v) { return Gelu(v); });
    case Activation::kIdentity:
      return;
  }
}

Kernels Table() {
  const std::string_view name = hwy::TargetName(HWY_TARGET);
  return {name == "AVX3" ? "AVX-512" : name.data(),
          Gemv,
          scalar_kernels().gemm,
          LayerNorm,
          Activate,
          scalar_kernels().attention};
}

}  // namespace HWY_NAMESPACE
}  // namespace tandem::policy
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace tandem::policy {
HWY_EXPORT(Table);

const std::vector<Kernels>& simd_kernels() {
  static const std::vector<Kernels> tables = [] {
    std::vector<int64_t> targets = hwy::SupportedAndGeneratedTargets();
    std::sort(targets.begin(), targets.end());  // a smaller bit is a better target
    std::vector<Kernels> found;
    for (const int64_t target : targets) {
      if (target == HWY_EMU128 || target == HWY_SCALAR) continue;  // those are not vector units
      hwy::GetChosenTarget().Update(target);
      found.push_back(HWY_DYNAMIC_DISPATCH(Table)());
    }
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    return found;
  }();
  return tables;
}

}  // namespace tandem::policy
#endif  // HWY_ONCE
