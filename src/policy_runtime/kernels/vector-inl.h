// What all kernels share. Compiled once per target, as every -inl.h here (see simd.cpp).
#if defined(TANDEM_POLICY_KERNELS_VECTOR_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef TANDEM_POLICY_KERNELS_VECTOR_INL_H_
#undef TANDEM_POLICY_KERNELS_VECTOR_INL_H_
#else
#define TANDEM_POLICY_KERNELS_VECTOR_INL_H_
#endif

#include <hwy/highway.h>

#include "policy_runtime/kernels/kernels.h"

HWY_BEFORE_NAMESPACE();
namespace tandem::policy {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// The registers of a target: at most kPadding floats, so that a panel is a whole number of them.
constexpr hn::CappedTag<float, kPadding> d;
using V = hn::Vec<decltype(d)>;
constexpr int kLanes = static_cast<int>(hn::MaxLanes(d));  // divides kPadding
constexpr int kRegisters = kPadding / kLanes;              // a column of a panel

// kLanes weights, as they lie in memory.
HWY_INLINE V LoadWeights(const float* w) { return hn::Load(d, w); }
HWY_INLINE V LoadWeights(const std::uint16_t* w) {
  constexpr hn::Rebind<std::uint16_t, decltype(d)> halves;
  constexpr hn::RebindToUnsigned<decltype(d)> bits;
  return hn::BitCast(d, hn::ShiftLeft<16>(hn::PromoteTo(bits, hn::Load(halves, w))));
}

// The kPadding sums of a register column, half added to half until one is left: the same at any
// register width.
HWY_INLINE float SumOfLanes(const V (&sums)[kRegisters]) {
  alignas(64) float lanes[kPadding];
  for (int r = 0; r < kRegisters; ++r) hn::Store(sums[r], d, lanes + r * kLanes);
  for (int half = kPadding / 2; half > 0; half /= 2) {
    for (int i = 0; i < half; ++i) lanes[i] += lanes[i + half];
  }
  return lanes[0];
}

}  // namespace HWY_NAMESPACE
}  // namespace tandem::policy
HWY_AFTER_NAMESPACE();

#endif
