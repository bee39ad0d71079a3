#include "support/allocation_counter.h"

#include <cerrno>
#include <cstddef>

namespace {
thread_local bool counting = false;
thread_local int64_t allocations = 0;
}  // namespace

extern "C" {
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);

void* malloc(size_t size) {
  allocations += counting;
  return __libc_malloc(size);
}
void* calloc(size_t n, size_t size) {
  allocations += counting;
  return __libc_calloc(n, size);
}
void* realloc(void* p, size_t size) {
  allocations += counting;
  return __libc_realloc(p, size);
}
void* aligned_alloc(size_t alignment, size_t size) {
  allocations += counting;
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** p, size_t alignment, size_t size) {
  allocations += counting;
  *p = __libc_memalign(alignment, size);
  return *p ? 0 : ENOMEM;
}
}

namespace tandem::testing {

AllocationCounter::AllocationCounter() {
  allocations = 0;
  counting = true;
}
AllocationCounter::~AllocationCounter() { counting = false; }
int64_t AllocationCounter::count() const { return allocations; }

}  // namespace tandem::testing
