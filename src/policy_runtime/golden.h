#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace tandem::policy {

class Policy;
class SafetensorsFile;

/// The examples that a policy file carries: inputs, and what the learner computes from them.
class Golden {
 public:
  /// Takes golden.observation (N, O), .chunk (N, h, A), with noise .noise (N, noise_size) and for
  /// each camera .image.NAME (N, height, width, 3) U8. @throws PolicyError
  Golden(SafetensorsFile& file, const Policy& policy);

  /// Evaluates all of them twice: the first pass also brings code and weights into the caches; both
  /// must agree. @returns the largest |ours - theirs|, in action units, or as a fraction of the
  /// axis's largest action where that is beyond 1.
  /// @throws PolicyError above Policy::kGoldenTolerance.
  double verify(const Policy& policy) const;

 private:
  double largest_error(const Policy& policy) const;

  std::string path_;
  std::int64_t count_;                             // N
  std::vector<float> observation_;                 // (N, O)
  std::vector<float> chunk_;                       // (N, h, A)
  std::vector<float> noise_;                       // (N, noise_size)
  std::vector<std::vector<std::uint8_t>> images_;  // per camera (N, height, width, 3)
};

}  // namespace tandem::policy
