#include "allocation_counter.h"

#include <cerrno>
#include <cstddef>

// Where the count lies must not itself be allocated on first use: no lazy thread-local storage.
static thread_local long allocations __attribute__((tls_model("initial-exec"))) = 0;

extern "C" long tandem_allocations() { return allocations; }

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)

// A sanitizer's own malloc stays in place; it tells us of every block.
extern "C" {
int __sanitizer_install_malloc_and_free_hooks(void (*on_malloc)(const volatile void*, size_t),
                                              void (*on_free)(const volatile void*));
}

static void on_malloc(const volatile void*, size_t) { ++allocations; }
static void on_free(const volatile void*) {}
static const int installed = __sanitizer_install_malloc_and_free_hooks(on_malloc, on_free);

#else

// Stands in for glibc's malloc and hands on to it by its internal names, which need no look-up.
extern "C" {
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);

void* malloc(size_t size) {
  ++allocations;
  return __libc_malloc(size);
}
void* calloc(size_t n, size_t size) {
  ++allocations;
  return __libc_calloc(n, size);
}
void* realloc(void* p, size_t size) {
  ++allocations;
  return __libc_realloc(p, size);
}
void* memalign(size_t alignment, size_t size) {
  ++allocations;
  return __libc_memalign(alignment, size);
}
void* aligned_alloc(size_t alignment, size_t size) {
  ++allocations;
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** p, size_t alignment, size_t size) {
  ++allocations;
  void* block = __libc_memalign(alignment, size);
  if (!block) return ENOMEM;
  *p = block;
  return 0;
}
}

#endif
