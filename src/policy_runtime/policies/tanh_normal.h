#pragma once

#include "policy_runtime/file/config_reader.h"
#include "policy_runtime/kernels/kernels.h"

namespace tandem::policy {

/// A normal distribution of n independent numbers, squeezed into (-1, 1):
///
///   tanh(mean + exp(clip(log_std, log_std_min, log_std_max)) noise).
///
/// A network gives (2 n) numbers: mean, then log_std.
class TanhNormal {
 public:
  /// Reads log_std_min and log_std_max. @throws PolicyError
  static TanhNormal read(ConfigReader& reader);

  /// Turns the log_std behind the n means into standard deviations, in place. Real-time.
  void to_deviations(float* mean_and_log_std, int n) const noexcept;

  /// out padded(n) from n standard normal numbers; its padding stays as it is. Real-time.
  void sample(const Kernels& kernels, const float* mean_and_deviation, int n, const float* noise,
              float* out) const noexcept;

 private:
  float log_std_min_ = 0.0f;
  float log_std_max_ = 0.0f;
};

}  // namespace tandem::policy
