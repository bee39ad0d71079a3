#pragma once

#include <cstdint>
#include <memory>

namespace tandem {

/// The latest of a stream, let through no more often than once a period. Used under a lock.
template <typename T>
class Paced {
 public:
  explicit Paced(int64_t period_us) : period_us_(period_us) {}

  /// Takes the place of what was offered before. @returns whether it is due: whoever sends must be
  /// woken.
  bool offer(const T& value, int64_t now_us) {
    latest_ = std::make_unique<T>(value);
    return now_us >= next_us_;
  }

  /// What is due, else null.
  std::unique_ptr<T> take(int64_t now_us) {
    if (!latest_ || now_us < next_us_) return nullptr;
    next_us_ = now_us + period_us_;
    return std::move(latest_);
  }

 private:
  int64_t period_us_;
  int64_t next_us_ = 0;
  std::unique_ptr<T> latest_;
};

}  // namespace tandem
