#pragma once

#include "policy_runtime/aligned_buffer.h"

namespace tandem::policy {

/// y += x over the first n and their padding; whole cache lines, which a compiler turns into
/// registers of any instruction set. x and y do not overlap. Real-time.
inline void add(const float* __restrict x, int n, float* __restrict y) noexcept {
  for (std::size_t line = 0; line < padded(n); line += kPadding) {
    for (int i = 0; i < kPadding; ++i) y[line + i] += x[line + i];
  }
}

}  // namespace tandem::policy
