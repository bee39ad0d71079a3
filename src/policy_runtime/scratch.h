#pragma once

#include <cstddef>

#include "policy_runtime/aligned_buffer.h"

namespace tandem::policy {

/// Hands out pieces of a workspace one after the other. Whoever says how large a workspace must be
/// counts the same padded() pieces.
class Scratch {
 public:
  explicit Scratch(float* begin) : next_(begin) {}

  /// padded(n) floats on a 64-byte boundary.
  float* take(std::size_t n) noexcept {
    float* piece = next_;
    next_ += padded(n);
    return piece;
  }

 private:
  float* next_;
};

}  // namespace tandem::policy
