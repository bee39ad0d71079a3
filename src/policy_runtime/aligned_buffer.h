#pragma once

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

/// One block of floats on a 64-byte boundary, zero at first, of fixed size.
class AlignedBuffer {
 public:
  explicit AlignedBuffer(std::size_t floats) : size_(padded(floats)), data_(allocate(size_)) {}

  float* data() noexcept { return data_.get(); }
  const float* data() const noexcept { return data_.get(); }
  std::size_t size() const noexcept { return size_; }  ///< floats, a multiple of kPadding

 private:
  static constexpr std::align_val_t kAlignment{64};
  struct Free {
    void operator()(float* block) const noexcept { ::operator delete[](block, kAlignment); }
  };
  static float* allocate(std::size_t floats) {
    void* block = ::operator new[](floats * sizeof(float), kAlignment);
    return static_cast<float*>(std::memset(block, 0, floats * sizeof(float)));
  }

  std::size_t size_;
  std::unique_ptr<float[], Free> data_;
};

/// Scratch memory of one evaluation at a time. Made by Policy::make_workspace() for that policy and
/// no other; threads that evaluate the same policy at once each need their own.
using Workspace = AlignedBuffer;

}  // namespace tandem::policy
