#pragma once

#include <memory>
#include <string>

#include "policy_runtime/aligned_buffer.h"
#include "policy_runtime/header.h"
#include "policy_runtime/policy_error.h"

namespace tandem::policy {

/// A trained policy: raw observation (O) -> action chunk (h, A) in [-1, 1]. Immutable once loaded.
///
/// One file in policies/ a kind of network; each owns its Config, Weights and the layout of its
/// workspace.
///
///   const auto policy = Policy::load("policy.safetensors");
///   Workspace workspace = policy->make_workspace();
///   std::vector<float> chunk(policy->header().chunk_size());
///   const bool usable = policy->forward(observation.data(), chunk.data(), workspace);
class Policy {
 public:
  /// Golden examples may differ by this much, in action units. Float rounding stays near 1e-6.
  static constexpr double kGoldenTolerance = 1e-5;

  /// Reads, checks and warms up a policy; slow, for a loader thread. The structure is checked
  /// before anything is sized by it, then every tensor, then the golden examples are run twice:
  /// once to verify, once with warm caches.
  /// @throws PolicyError naming the file, what was found, the limit and the remedy.
  static std::unique_ptr<const Policy> load(const std::string& path);

  virtual ~Policy() = default;
  Policy(const Policy&) = delete;
  Policy& operator=(const Policy&) = delete;

  const Header& header() const noexcept { return header_; }

  /// Largest absolute difference between our golden chunks and the learner's, in action units.
  double golden_error() const noexcept { return golden_error_; }

  /// Scratch for forward(), sized for this policy.
  Workspace make_workspace() const { return Workspace(workspace_size()); }

  /// observation (O) in SI units as the names say, not normalised -> chunk (h, A), row-major.
  ///
  /// Real-time: no allocation, no lock, no exception, bounded time. The same observation gives the
  /// same bits under the same kernel. False when the observation (or what became of it) is not
  /// finite: the chunk is then all zeros.
  [[nodiscard]] virtual bool forward(const float* observation, float* chunk,
                                     Workspace& workspace) const noexcept = 0;

 protected:
  explicit Policy(Header header) : header_(std::move(header)) {}
  virtual std::size_t workspace_size() const noexcept = 0;  ///< floats

 private:
  Header header_;
  double golden_error_ = 0.0;
};

}  // namespace tandem::policy
