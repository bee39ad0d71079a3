// Layer norm and activations.
#if defined(TANDEM_POLICY_KERNELS_ELEMENTWISE_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef TANDEM_POLICY_KERNELS_ELEMENTWISE_INL_H_
#undef TANDEM_POLICY_KERNELS_ELEMENTWISE_INL_H_
#else
#define TANDEM_POLICY_KERNELS_ELEMENTWISE_INL_H_
#endif

#include <hwy/contrib/math/math-inl.h>

#include <algorithm>
#include <cmath>

#include "policy_runtime/kernels/vector-inl.h"

HWY_BEFORE_NAMESPACE();
namespace tandem::policy {
namespace HWY_NAMESPACE {

// Sum of f(y[i]) over the first n, in kPadding sums.
template <typename F>
HWY_INLINE float Sum(const float* y, int n, F f) {
  V sum[kRegisters];
  for (V& each : sum) each = hn::Zero(d);
  int i = 0;
  for (; i + kPadding <= n; i += kPadding) {
    HWY_UNROLL(4)
    for (int r = 0; r < kRegisters; ++r) {
      sum[r] = hn::Add(sum[r], f(hn::Load(d, y + i + r * kLanes)));
    }
  }
  for (int r = 0; i < n; i += kLanes, ++r) {
    const auto inside = hn::FirstN(d, std::min(n - i, kLanes));
    sum[r] = hn::Add(sum[r], hn::IfThenElseZero(inside, f(hn::Load(d, y + i))));
  }
  return SumOfLanes(sum);
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
      return ForEach(y, n, [](V v) { return hn::Max(hn::Zero(d), v); });
    case Activation::kTanh:
      return ForEach(y, n, [](V v) { return hn::Tanh(d, v); });
    case Activation::kGelu:
      return ForEach(y, n, [](V v) { return Gelu(v); });
    case Activation::kIdentity:
      return;
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace tandem::policy
HWY_AFTER_NAMESPACE();

#endif
