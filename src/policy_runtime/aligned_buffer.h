#pragma once

#ifdef __linux__
#include <sys/mman.h>
#endif

#include <cstddef>
#include <cstring>
#include <memory>
#include <new>

namespace tandem::policy {

/// Every vector that a kernel touches is padded with zeros to this many floats (one cache line), so
/// that kernels load whole registers and never handle a tail.
inline constexpr int kPadding = 16;

/// n rounded up to whole cache lines.
constexpr std::size_t padded(std::size_t n) { return (n + kPadding - 1) / kPadding * kPadding; }

/// One block of floats on a 64-byte boundary (megabytes: on large pages), zero at first, of fixed
/// size.
class AlignedBuffer {
 public:
  explicit AlignedBuffer(std::size_t floats) : size_(padded(floats)), data_(allocate(size_)) {}

  float* data() noexcept { return data_.get(); }
  const float* data() const noexcept { return data_.get(); }
  std::size_t size() const noexcept { return size_; }  ///< floats, a multiple of kPadding

 private:
  // What streams through the processor by the megabyte lies in large pages where the system has
  // them: a page of 4 KB a time costs a look-up each.
  static constexpr std::size_t kLargePage = std::size_t{1} << 21;  // bytes

  static constexpr std::size_t alignment(std::size_t bytes) {
    return bytes >= kLargePage / 2 ? kLargePage : 64;
  }

  struct Free {
    std::align_val_t alignment;
    void operator()(float* block) const noexcept { ::operator delete[](block, alignment); }
  };
  using Block = std::unique_ptr<float[], Free>;

  static Block allocate(std::size_t floats) {
    std::size_t bytes = floats * sizeof(float);
    const std::align_val_t aligned{alignment(bytes)};
    if (bytes >= kLargePage / 2) bytes = (bytes + kLargePage - 1) / kLargePage * kLargePage;
    Block block(static_cast<float*>(::operator new[](bytes, aligned)), Free{aligned});
#ifdef __linux__
    if (bytes >= kLargePage) madvise(block.get(), bytes, MADV_HUGEPAGE);  // a wish; may be refused
#endif
    std::memset(block.get(), 0, bytes);
    return block;
  }

  std::size_t size_;
  Block data_;
};

/// Scratch memory of one evaluation at a time. Made by Policy::make_workspace() for that policy and
/// no other; threads that evaluate the same policy at once each need their own.
using Workspace = AlignedBuffer;

}  // namespace tandem::policy
