#pragma once

#include <cstdint>

namespace tandem::testing {

/// Counts heap allocations of this thread (malloc and all that ends there: new, Eigen, C libraries)
/// while it lives. Link allocation_counter.cpp into the test program; it stands in for glibc's
/// malloc.
class AllocationCounter {
 public:
  AllocationCounter();
  ~AllocationCounter();
  int64_t count() const;  ///< since construction
};

}  // namespace tandem::testing
