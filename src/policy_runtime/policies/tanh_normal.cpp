#include "policy_runtime/policies/tanh_normal.h"

#include <algorithm>
#include <cmath>

namespace tandem::policy {

TanhNormal TanhNormal::read(ConfigReader& reader) {
  constexpr double kLimit = 20.0;  // exp(20) is still far from the largest float
  TanhNormal result;
  result.log_std_min_ = static_cast<float>(reader.number("log_std_min", -kLimit, kLimit));
  result.log_std_max_ = static_cast<float>(reader.number("log_std_max", -kLimit, kLimit));
  if (result.log_std_min_ > result.log_std_max_) {
    reader.refuse("has a log_std_min above log_std_max; it must not be larger.");
  }
  return result;
}

void TanhNormal::to_deviations(float* mean_and_log_std, int n) const noexcept {
  for (float* p = mean_and_log_std + n; p < mean_and_log_std + 2 * n; ++p) {
    *p = std::exp(std::clamp(*p, log_std_min_, log_std_max_));
  }
}

void TanhNormal::sample(const Kernels& kernels, const float* mean_and_deviation, int n,
                        const float* noise, float* out) const noexcept {
  const float* mean = mean_and_deviation;
  const float* deviation = mean_and_deviation + n;
  for (int i = 0; i < n; ++i) out[i] = mean[i] + deviation[i] * noise[i];
  kernels.activate(Activation::kTanh, out, n);
}

}  // namespace tandem::policy
