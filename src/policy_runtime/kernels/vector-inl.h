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

}  // namespace HWY_NAMESPACE
}  // namespace tandem::policy
HWY_AFTER_NAMESPACE();

#endif
