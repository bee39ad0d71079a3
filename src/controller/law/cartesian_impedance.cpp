#include "controller/law/cartesian_impedance.h"

#include <algorithm>
#include <cmath>

namespace tandem {
namespace {

// Damping of the pseudo-inverse: large enough that a stretched arm gives bounded torques, too small
// to matter elsewhere (smallest singular value of J at the home pose: 0.2).
constexpr double kLambda = 0.02;

// Near a singularity the joints can move fast while the tool stands still, where D does not see
// them. Distance from it: 0.16 at the home pose, 0.08 at the nearest corner of the peg's workspace,
// 0.03 with the arm stretched.
constexpr double kSingular = 0.07;         // below it joint damping begins
constexpr double kSingularDamping = 20.0;  // N m s/rad at distance 0

Eigen::LLT<Matrix6> damped_gram(const Jacobian& J) noexcept {
  Matrix6 gram;
  gram.noalias() = J.lazyProduct(J.transpose());
  gram.diagonal().array() += kLambda * kLambda;
  return Eigen::LLT<Matrix6>(gram);
}

// (sum over the singular values of J of 1 / sigma^2)^-1/2, damped: a smooth stand-in for the
// smallest of them.
double distance_from_singularity(const Eigen::LLT<Matrix6>& gram) noexcept {
  Matrix6 inverse_root = Matrix6::Identity();
  gram.matrixL().solveInPlace(inverse_root);
  return 1.0 / inverse_root.norm();
}

// A six-vector in the axes of a frame that R turns: translation and rotation alike.
Twist turned(const Eigen::Matrix3d& R, const Twist& v) noexcept {
  Twist out;
  out.head<3>() = R.lazyProduct(v.head<3>());
  out.tail<3>() = R.lazyProduct(v.tail<3>());
  return out;
}

// Spring on the clipped error, damper on the velocity error; base axes in and out.
Wrench wrench_of(const ImpedanceGains& gains, const Eigen::Quaterniond& R_WE, const Twist& error,
                 const Twist& velocity_error, double stiffness_share) noexcept {
  const auto in_axes = [&](const Twist& e, const Twist& v) -> Wrench {
    const Twist clipped = e.cwiseMax(-gains.clip_low).cwiseMin(gains.clip_high);
    const Wrench spring = gains.stiffness.lazyProduct(clipped);
    return stiffness_share * spring + gains.damping.lazyProduct(v);
  };
  if (!gains.tool_axes) return in_axes(error, velocity_error);
  const Eigen::Matrix3d R = R_WE.toRotationMatrix(), R_EW = R.transpose();
  return turned(R, in_axes(turned(R_EW, error), turned(R_EW, velocity_error)));
}

// Spring with critical damping for a unit inertia, capped.
JointVector posture_torque(const ImpedanceGains& gains, const ArmState& arm,
                           double stiffness_share) noexcept {
  const JointVector spring = stiffness_share * gains.posture_stiffness * (gains.posture - arm.q);
  const JointVector damper = 2.0 * std::sqrt(gains.posture_stiffness) * arm.dq;
  return (spring - damper)
      .cwiseMax(-gains.posture_torque_limit)
      .cwiseMin(gains.posture_torque_limit);
}

// Largest |(A c)_i| over the box of clipped errors c, where A turns the spring's force to base
// axes.
Wrench bound_of(const ImpedanceGains& gains, const Eigen::Quaterniond& R_WE) noexcept {
  Matrix6 A = gains.stiffness;
  if (gains.tool_axes) {
    const Eigen::Matrix3d R = R_WE.toRotationMatrix();
    A.topRows<3>() = R.lazyProduct(gains.stiffness.topRows<3>());
    A.bottomRows<3>() = R.lazyProduct(gains.stiffness.bottomRows<3>());
  }
  Wrench bound;
  for (int i = 0; i < 6; ++i) {
    double high = 0.0, low = 0.0;
    for (int j = 0; j < 6; ++j) {
      high += std::max(A(i, j) * gains.clip_high[j], -A(i, j) * gains.clip_low[j]);
      low += std::max(-A(i, j) * gains.clip_high[j], A(i, j) * gains.clip_low[j]);
    }
    bound[i] = std::max(high, low);
  }
  return bound;
}

}  // namespace

void CartesianImpedance::reset() noexcept {
  if (has_next_) gains_ = next_;
  has_next_ = damped_ = false;
  ramp_left_ = fade_ = 0;
}

void CartesianImpedance::set_gains(const ImpedanceGains& gains) noexcept {
  if (ramp_left_ > 0) {
    next_ = gains;
    has_next_ = true;
    return;
  }
  from_ = gains_;
  gains_ = gains;
  ramp_left_ = kRampTicks;
}

JointVector CartesianImpedance::torque(const ArmState& arm,
                                       const PoseReference& reference) noexcept {
  if (ramp_left_ > 0) {
    --ramp_left_;
  } else if (has_next_) {
    has_next_ = false;
    set_gains(next_);
  }
  fade_ = std::clamp(fade_ + (damped_ ? 1 : -1), 0, kFadeTicks);
  const double share = stiffness_share();

  const Twist error = minus(reference.X_WE, arm.X_WE);
  const Twist velocity_error = share * reference.V_WE - arm.V_WE;
  Wrench wrench = wrench_of(gains_, arm.X_WE.R, error, velocity_error, share);
  JointVector posture = posture_torque(gains_, arm, share);
  if (ramp_left_ > 0) {
    const double s = ramped();
    wrench = s * wrench + (1.0 - s) * wrench_of(from_, arm.X_WE.R, error, velocity_error, share);
    posture = s * posture + (1.0 - s) * posture_torque(from_, arm, share);
  }

  // The posture task is projected out of the tool's motion.
  const Eigen::LLT<Matrix6> gram = damped_gram(arm.J);
  const Wrench leak = gram.solve(arm.J.lazyProduct(posture));

  JointVector tau = arm.J.transpose().lazyProduct(wrench - leak) + posture + arm.coriolis;

  const double distance = distance_from_singularity(gram);
  if (distance < kSingular) {
    const double near = 1.0 - distance / kSingular;
    tau -= kSingularDamping * near * near * arm.dq;
  }
  return tau;
}

Wrench CartesianImpedance::force_bound(const Eigen::Quaterniond& R_WE) const noexcept {
  Wrench bound = bound_of(gains_, R_WE);
  if (ramp_left_ > 0) bound = ramped() * bound + (1.0 - ramped()) * bound_of(from_, R_WE);
  return stiffness_share() * bound;
}

Twist CartesianImpedance::allowed(const Twist& increment, const Twist& lead,
                                  const Eigen::Quaterniond& R_WE) const noexcept {
  const auto in_axes = [&](const Twist& step, const Twist& ahead) -> Twist {
    Twist out;
    for (int i = 0; i < 6; ++i) {
      out[i] = step[i] >= 0.0 ? std::min(step[i], std::max(0.0, gains_.clip_high[i] - ahead[i]))
                              : std::max(step[i], std::min(0.0, -gains_.clip_low[i] - ahead[i]));
    }
    return out;
  };
  if (!gains_.tool_axes) return in_axes(increment, lead);
  const Eigen::Matrix3d R = R_WE.toRotationMatrix(), R_EW = R.transpose();
  return turned(R, in_axes(turned(R_EW, increment), turned(R_EW, lead)));
}

Wrench external_wrench(const Jacobian& J, const JointVector& tau_external) noexcept {
  return damped_gram(J).solve(J.lazyProduct(tau_external));
}

}  // namespace tandem
