#include "policy_runtime/policies/velocity_field.h"

#include <cmath>
#include <numbers>

namespace tandem::policy {

std::vector<double> time_features(int n, double t) {
  std::vector<double> phi(n);
  for (int i = 0; i < n / 2; ++i) {
    const double angle = std::numbers::pi * (i + 1) * t;
    phi[i] = std::cos(angle);
    phi[n / 2 + i] = std::sin(angle);
  }
  return phi;
}

}  // namespace tandem::policy
