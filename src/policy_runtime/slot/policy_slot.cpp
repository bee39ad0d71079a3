#include "policy_runtime/slot/policy_slot.h"

namespace tandem::policy {

void PolicySlot::publish(std::unique_ptr<const Policy> policy) {
  Workspace workspace = policy->make_workspace();
  owned_.push_back(
      std::make_unique<Active>(Active{std::move(policy), std::move(workspace), ++published_}));
  Active* skipped = offered_.exchange(owned_.back().get(), std::memory_order_acq_rel);
  if (skipped) std::erase_if(owned_, [&](const auto& each) { return each.get() == skipped; });
  collect();
}

void PolicySlot::collect() {
  // the reader echoes a sequence after its last use of every earlier one
  const std::uint64_t in_force = sequence_in_force_.load(std::memory_order_acquire);
  std::erase_if(owned_, [&](const auto& each) { return each->sequence < in_force; });
}

PolicySlot::Active* PolicySlot::acquire() noexcept {
  if (offered_.load(std::memory_order_relaxed) != nullptr) {
    // only we take an offer away, so the exchange finds this one or a newer one
    current_ = offered_.exchange(nullptr, std::memory_order_acq_rel);
    version_in_force_.store(current_->policy->header().version, std::memory_order_release);
    sequence_in_force_.store(current_->sequence, std::memory_order_release);
  }
  return current_;
}

}  // namespace tandem::policy
