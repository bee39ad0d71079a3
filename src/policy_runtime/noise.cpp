#include "policy_runtime/noise.h"

#include <cmath>
#include <numbers>

namespace tandem::policy {
namespace {

// SplitMix64 (Steele, Lea, Flood 2014): word i of a seed, without the words before it.
std::uint64_t word(std::uint64_t seed, std::uint64_t i) {
  std::uint64_t z = seed + (i + 1) * 0x9E3779B97F4A7C15u;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
  return z ^ (z >> 31);
}

}  // namespace

void standard_normal(std::uint64_t seed, float* out, int n) noexcept {
  constexpr double kUnit = 0x1p-53;
  for (int i = 0; i < n; i += 2) {
    const double u = double((word(seed, i) >> 11) + 1) * kUnit;  // (0, 1]: its logarithm is finite
    const double angle = 2.0 * std::numbers::pi * double(word(seed, i + 1) >> 11) * kUnit;
    const double radius = std::sqrt(-2.0 * std::log(u));
    out[i] = static_cast<float>(radius * std::cos(angle));
    if (i + 1 < n) out[i + 1] = static_cast<float>(radius * std::sin(angle));
  }
}

}  // namespace tandem::policy
