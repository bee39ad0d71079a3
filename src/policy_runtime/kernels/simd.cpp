// Highway compiles this file once per instruction set (foreach_target.h) and HWY_DYNAMIC_DISPATCH
// finds them again.
#include <algorithm>
#include <string_view>
#include <vector>

#include "policy_runtime/kernels/kernels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "policy_runtime/kernels/simd.cpp"
// foreach_target.h must come before everything that is compiled per target
// clang-format off
#include <hwy/foreach_target.h>
// clang-format on
#include "policy_runtime/kernels/attention-inl.h"
#include "policy_runtime/kernels/elementwise-inl.h"
#include "policy_runtime/kernels/gemm-inl.h"
#include "policy_runtime/kernels/gemv-inl.h"
#include "policy_runtime/kernels/winograd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace tandem::policy {
namespace HWY_NAMESPACE {

Kernels Table() {
  const std::string_view name = hwy::TargetName(HWY_TARGET);
  return {name == "AVX3" ? "AVX-512" : name.data(),
          Gemv,
          Gemm,
          LayerNorm,
          Activate,
          Attention,
          WinogradInput,
          WinogradOut};
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
