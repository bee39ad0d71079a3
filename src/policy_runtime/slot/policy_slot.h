#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "policy_runtime/policy.h"

namespace tandem::policy {

/// Where the loader thread leaves a new policy and the policy thread finds it, without either
/// waiting for the other.
///
/// One loader, one reader. The reader pays one atomic load when there is nothing new, and two more
/// atomic operations when there is; it never allocates, frees or waits. A policy is destroyed on
/// the loader's thread, and only after the reader has moved on to a later one. Publishing twice
/// before the reader looks simply skips the first.
class PolicySlot {
 public:
  /// A policy with the scratch memory to evaluate it.
  struct Active {
    std::unique_ptr<const Policy> policy;
    Workspace workspace;
    std::uint64_t sequence;  ///< counts publications of this slot, from 1

    /// Policy::forward() with our workspace. Reader's thread only.
    [[nodiscard]] bool forward(const Input& input, float* chunk) noexcept {
      return policy->forward(input, chunk, workspace);
    }
  };

  PolicySlot() = default;
  PolicySlot(const PolicySlot&) = delete;
  PolicySlot& operator=(const PolicySlot&) = delete;

  /// Loader: offers a loaded policy to the reader; then collect(). Allocates.
  void publish(std::unique_ptr<const Policy> policy);

  /// Loader: destroys the policies that the reader has let go of. Call it now and then to free the
  /// last one early.
  void collect();

  /// Reader, at a chunk boundary: the newest policy, or null before the first. Wait-free. What an
  /// earlier call returned is let go of by this one and must not be used any more.
  Active* acquire() noexcept;

  /// Any thread: version of the policy that the reader acquired last; -1 before the first.
  std::int64_t version_in_force() const noexcept {
    return version_in_force_.load(std::memory_order_acquire);
  }

  /// Loader: policies that are still in memory.
  std::size_t alive() const { return owned_.size(); }

 private:
  // loader's
  std::vector<std::unique_ptr<Active>> owned_;
  std::uint64_t published_ = 0;

  // shared; each on a cache line of its own
  alignas(64) std::atomic<Active*> offered_{nullptr};            // not yet acquired, or null
  alignas(64) std::atomic<std::uint64_t> sequence_in_force_{0};  // echo of the reader
  std::atomic<std::int64_t> version_in_force_{-1};

  // reader's
  alignas(64) Active* current_ = nullptr;
};

}  // namespace tandem::policy
