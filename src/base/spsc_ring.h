#pragma once

#include <atomic>
#include <cstddef>
#include <vector>

namespace tandem {

/// Wait-free queue between one writing and one reading thread. Memory is taken once, in the
/// constructor.
template <typename T>
class SpscRing {
 public:
  explicit SpscRing(size_t capacity) : slots_(capacity + 1) {}

  /// Slot to fill in place, or null when the ring is full. Nothing is visible to the reader before
  /// publish().
  T* claim() noexcept {
    const size_t tail = tail_.load(std::memory_order_relaxed);
    return next(tail) == head_.load(std::memory_order_acquire) ? nullptr : &slots_[tail];
  }
  void publish() noexcept {
    tail_.store(next(tail_.load(std::memory_order_relaxed)), std::memory_order_release);
  }

  /// Copies a value in. @returns false when full.
  bool push(const T& value) noexcept {
    T* slot = claim();
    if (!slot) return false;
    *slot = value;
    publish();
    return true;
  }

  /// Oldest value, or null when empty. It stays valid until pop().
  T* front() noexcept {
    const size_t head = head_.load(std::memory_order_relaxed);
    return head == tail_.load(std::memory_order_acquire) ? nullptr : &slots_[head];
  }
  void pop() noexcept {
    head_.store(next(head_.load(std::memory_order_relaxed)), std::memory_order_release);
  }

  /// Number of values waiting; exact only for the reader and the writer at rest.
  size_t size() const noexcept {
    const size_t head = head_.load(std::memory_order_acquire);
    const size_t tail = tail_.load(std::memory_order_acquire);
    return tail >= head ? tail - head : slots_.size() - head + tail;
  }
  size_t capacity() const noexcept { return slots_.size() - 1; }

 private:
  size_t next(size_t i) const noexcept { return i + 1 == slots_.size() ? 0 : i + 1; }

  std::vector<T> slots_;
  alignas(64) std::atomic<size_t> head_{0};
  alignas(64) std::atomic<size_t> tail_{0};
};

}  // namespace tandem
