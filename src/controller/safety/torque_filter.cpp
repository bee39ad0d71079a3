#include "controller/safety/torque_filter.h"

namespace tandem {

JointVector TorqueFilter::torque_limit() noexcept {
  JointVector limit;
  limit << 87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0;
  return limit;
}

JointVector TorqueFilter::limit(const JointVector& requested,
                                const JointVector& previous) noexcept {
  JointVector tau = requested;
  if (!tau.allFinite()) {
    tau.setZero();
    ++not_finite_count_;
  }
  const JointVector limit = torque_limit();
  tau = tau.cwiseMax(-limit).cwiseMin(limit);
  const JointVector change = (tau - previous).cwiseMax(-kStep).cwiseMin(kStep);
  return previous + change;
}

}  // namespace tandem
