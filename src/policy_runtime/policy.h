#pragma once

#include <memory>
#include <string>
#include <vector>

#include "policy_runtime/aligned_buffer.h"
#include "policy_runtime/header.h"
#include "policy_runtime/policies/head.h"
#include "policy_runtime/policy_error.h"

namespace tandem::policy {

/// What a policy computes a chunk from.
struct Input {
  const float* observation = nullptr;  ///< (O) in SI units as the names say, not normalised
  const std::uint8_t* const* images =
      nullptr;                   ///< per camera of cameras(): (height, width, 3) RGB; else null
  const float* noise = nullptr;  ///< (noise_size) standard normal numbers; null: made from the seed
  std::uint64_t seed = 0;        ///< of the noise when there is none
};

/// A trained policy: raw observation (O), images, noise -> action chunk (h, A). Immutable once
/// loaded; any number of threads may evaluate it, each with a workspace of its own.
///
///   const auto policy = Policy::load("policy.safetensors");
///   Workspace workspace = policy->make_workspace();
///   std::vector<float> chunk(policy->header().chunk_size());
///   const bool usable = policy->forward({.observation = observation}, chunk.data(), workspace);
class Policy {
 public:
  /// Golden examples may differ by this much, in action units, or as a fraction of the axis's
  /// largest action where that is beyond 1. Float rounding stays near 1e-6.
  static constexpr double kGoldenTolerance = 1e-5;

  /// Reads, checks and warms up a policy; slow, for a loader thread. The structure is checked
  /// before anything is sized by it, then every tensor, then the golden examples are run twice:
  /// once to verify, once with warm caches.
  /// @throws PolicyError naming the file, what was found, the limit and the remedy.
  static std::unique_ptr<const Policy> load(const std::string& path);

  /// A policy of a head made elsewhere, without golden examples.
  /// @param mean, scale (O): the head sees (observation - mean) * scale
  Policy(Header header, std::vector<float> mean, std::vector<float> scale,
         std::unique_ptr<const Head> head);

  const Header& header() const noexcept { return header_; }
  const std::vector<Camera>& cameras() const noexcept { return head_->cameras(); }

  /// Standard normal numbers that forward() takes; 0: the policy is deterministic.
  int noise_size() const noexcept { return head_->noise_size(); }

  /// Largest difference between our golden chunks and the learner's; see kGoldenTolerance.
  double golden_error() const noexcept { return golden_error_; }

  /// Scratch for forward(), sized for this policy.
  Workspace make_workspace() const;

  /// Input -> chunk (h, A), row-major.
  ///
  /// Real-time: no allocation, no lock, no exception, bounded time. The same input gives the same
  /// bits under the same kernel. False when the observation (or what became of it) is not finite,
  /// or images are missing: the chunk is then all zeros.
  [[nodiscard]] bool forward(const Input& input, float* chunk, Workspace& workspace) const noexcept;

 private:
  Header header_;
  std::vector<float> mean_;   // (O)
  std::vector<float> scale_;  // (O), one over the standard deviation
  std::unique_ptr<const Head> head_;
  double golden_error_ = 0.0;
};

}  // namespace tandem::policy
