#pragma once

#include <cstdint>

#include "bench/allocation_counter.h"

namespace tandem::testing {

/// Heap allocations of this thread (malloc and all that ends there: new, Eigen, C libraries) since
/// construction. The library test_support brings the malloc that counts.
class AllocationCounter {
 public:
  int64_t count() const { return tandem_allocations() - before_; }

 private:
  long before_ = tandem_allocations();
};

}  // namespace tandem::testing
