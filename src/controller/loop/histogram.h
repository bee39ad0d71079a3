#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <vector>

namespace tandem {

/// Distribution of a duration: 50 000 buckets (0.2 us wide, up to 10 ms, if nothing else is said),
/// the exact maximum beyond. One thread adds, any thread reads.
class Histogram {
 public:
  /// p50, p99, p99.9 and max, us.
  using Summary = std::array<double, 4>;

  explicit Histogram(int64_t bucket_ns = kBucketNs) noexcept : bucket_ns_(bucket_ns) {}

  void add_ns(int64_t ns) noexcept {
    const int64_t bucket = ns < 0 ? 0 : ns / bucket_ns_;
    auto& count = counts_[bucket < kBuckets ? bucket : kBuckets - 1];
    count.store(count.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
    if (ns > max_ns_.load(std::memory_order_relaxed)) max_ns_.store(ns, std::memory_order_relaxed);
    total_.store(total_.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
  }

  Summary summary() const noexcept {
    const double max_us = 1e-3 * static_cast<double>(max_ns_.load(std::memory_order_relaxed));
    const int64_t total = total_.load(std::memory_order_relaxed);
    if (total == 0) return {0.0, 0.0, 0.0, 0.0};
    const double shares[3] = {0.5, 0.99, 0.999};
    Summary result{max_us, max_us, max_us, max_us};
    int64_t seen = 0;
    int next = 0;
    for (int64_t i = 0; i < kBuckets - 1 && next < 3; ++i) {
      seen += counts_[i].load(std::memory_order_relaxed);
      while (next < 3 && static_cast<double>(seen) >= shares[next] * static_cast<double>(total)) {
        result[next++] = 1e-3 * static_cast<double>((i + 1) * bucket_ns_);
      }
    }
    return result;
  }

  /// Of all buckets, up to the last that is not empty.
  std::vector<int64_t> counts() const {
    std::vector<int64_t> result(counts_.begin(), counts_.end());
    while (!result.empty() && result.back() == 0) result.pop_back();
    return result;
  }

  static constexpr int64_t kBucketNs = 200, kBuckets = 50001;

 private:
  int64_t bucket_ns_;
  std::array<std::atomic<int64_t>, kBuckets> counts_{};
  std::atomic<int64_t> max_ns_{0}, total_{0};
};

}  // namespace tandem
