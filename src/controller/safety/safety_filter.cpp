#include "controller/safety/safety_filter.h"

#include <algorithm>
#include <cmath>

namespace tandem {
namespace {

// Speeds at which a limit's push doubles while the arm still approaches: dissipation that is
// continuous at the border, where plain damping would jump.
constexpr double kWallSpeed = 0.1;   // m/s
constexpr double kJointSpeed = 0.5;  // rad/s

// Of a joint's torque limit, what brakes it at its velocity limit.
constexpr double kBrakeShare = 0.5;

// Damping that answers a request that is not finite: N m s/rad, joints 1 to 4 and 5 to 7.
constexpr double kDamping = 10.0, kWristDamping = 2.0;

}  // namespace

SafetySettings read_safety(Section section) {
  SafetySettings settings;
  settings.wall_stiffness = section.number("wall_stiffness_N_m", 0.0, 6000.0);
  settings.wall_force_limit = section.number("wall_force_limit_N", 0.0, 100.0);
  settings.joint_margin = section.number("joint_margin_rad", 0.01, 0.5);
  settings.joint_repulsion = section.number("joint_repulsion_Nm", 0.0, 87.0);
  settings.velocity_margin = section.number("velocity_margin", 0.1, 0.99);
  section.finish();
  return settings;
}

JointVector SafetyFilter::torque_limit() noexcept {
  JointVector limit;
  limit << 87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0;
  return limit;
}

SafetyFilter::SafetyFilter(const SafetySettings& settings, const ArmModel& model,
                           const Eigen::Vector3d& workspace_low,
                           const Eigen::Vector3d& workspace_high)
    : settings_(settings),
      lower_(model.lower_limit()),
      upper_(model.upper_limit()),
      velocity_(model.velocity_limit()),
      workspace_low_(workspace_low),
      workspace_high_(workspace_high) {}

JointVector SafetyFilter::limit(const ArmState& arm, const JointVector& requested,
                                const JointVector& previous) noexcept {
  acted_ = 0;
  const JointVector limit = torque_limit();
  JointVector tau = requested;
  const bool measured = arm.q.allFinite() && arm.dq.allFinite() && arm.X_WE.p.allFinite();
  if (tau.allFinite() && measured) {
    push_back_from_walls(arm, tau);
    keep_within_positions(arm, tau);
    keep_within_velocities(arm, tau);
  }
  if (!tau.allFinite() || !measured) {
    acted_ = not_finite;
    tau.head<4>() = -kDamping * arm.dq.head<4>();
    tau.tail<3>() = -kWristDamping * arm.dq.tail<3>();
    if (!tau.allFinite()) tau.setZero();
  }

  const JointVector within = tau.cwiseMax(-limit).cwiseMin(limit);
  if (within != tau) acted_ |= torque;

  const JointVector last = previous.allFinite() ? previous : JointVector::Zero();
  const JointVector change = within - last;
  const JointVector step = change.cwiseMax(-kStep).cwiseMin(kStep);
  if (step != change) acted_ |= torque_rate;

  for (size_t i = 0; i < counts_.size(); ++i) counts_[i] += (acted_ >> i) & 1u;
  // Again, because the sum may round to just above what the robot takes.
  return (last + step).cwiseMax(-limit).cwiseMin(limit);
}

void SafetyFilter::push_back_from_walls(const ArmState& arm, JointVector& tau) noexcept {
  Eigen::Vector3d force = Eigen::Vector3d::Zero();
  for (int i = 0; i < 3; ++i) {
    const double beyond = arm.X_WE.p[i] > workspace_high_[i]  ? arm.X_WE.p[i] - workspace_high_[i]
                          : arm.X_WE.p[i] < workspace_low_[i] ? arm.X_WE.p[i] - workspace_low_[i]
                                                              : 0.0;
    if (beyond == 0.0) continue;
    const double outwards = std::copysign(1.0, beyond);
    const double approach = std::max(0.0, outwards * arm.V_WE[i]);
    force[i] = -outwards *
               std::min(settings_.wall_force_limit, settings_.wall_stiffness * std::abs(beyond) *
                                                        (1.0 + approach / kWallSpeed));
  }
  if (force.isZero(0.0)) return;
  acted_ |= wall;
  tau += arm.J.topRows<3>().transpose().lazyProduct(force);
}

void SafetyFilter::keep_within_positions(const ArmState& arm, JointVector& tau) noexcept {
  for (int i = 0; i < 7; ++i) {
    const double above = arm.q[i] - (upper_[i] - settings_.joint_margin);
    const double below = arm.q[i] - (lower_[i] + settings_.joint_margin);
    const double outwards = above > 0.0 ? 1.0 : -1.0;
    const double depth = above > 0.0 ? above : below < 0.0 ? -below : 0.0;
    if (depth == 0.0) continue;
    const double share = std::min(1.0, depth / settings_.joint_margin);
    const double approach = std::max(0.0, outwards * arm.dq[i]);
    if (outwards * tau[i] > 0.0) tau[i] *= 1.0 - share;
    tau[i] -= outwards * share * settings_.joint_repulsion * (1.0 + approach / kJointSpeed);
    acted_ |= joint_position;
  }
}

void SafetyFilter::keep_within_velocities(const ArmState& arm, JointVector& tau) noexcept {
  const JointVector limit = torque_limit();
  for (int i = 0; i < 7; ++i) {
    const double used = std::abs(arm.dq[i]) / velocity_[i];
    if (!(used > settings_.velocity_margin)) continue;
    const double share =
        std::min(1.0, (used - settings_.velocity_margin) / (1.0 - settings_.velocity_margin));
    const double forward = std::copysign(1.0, arm.dq[i]);
    if (forward * tau[i] > 0.0) tau[i] *= 1.0 - share;
    tau[i] -= forward * share * kBrakeShare * limit[i];
    acted_ |= joint_velocity;
  }
}

}  // namespace tandem
