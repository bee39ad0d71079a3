#include "controller/law/cartesian_impedance.h"

#include <cmath>

namespace tandem {
namespace {

// Damping of the pseudo-inverse: large enough that a stretched arm gives bounded torques, too small
// to matter elsewhere (smallest singular value of J at the home pose: 0.2).
constexpr double kLambda = 0.02;

Eigen::LLT<Eigen::Matrix<double, 6, 6>> damped_gram(const Jacobian& J) noexcept {
  Eigen::Matrix<double, 6, 6> gram;
  gram.noalias() = J.lazyProduct(J.transpose());
  gram.diagonal().array() += kLambda * kLambda;
  return Eigen::LLT<Eigen::Matrix<double, 6, 6>>(gram);
}

}  // namespace

ImpedanceGains read_gains(Section section) {
  ImpedanceGains gains;
  const std::vector<double> stiffness = section.numbers("stiffness", 6, 0.0, 6000.0);
  const std::vector<double> inertia = section.numbers("apparent_inertia", 6, 0.001, 50.0);
  const std::vector<double> clip = section.numbers("error_clip", 6, 0.0, 0.5);
  const std::vector<double> posture = section.numbers("posture", 7, -3.8, 3.8);
  const double ratio = section.number("damping_ratio", 0.0, 3.0);
  for (int i = 0; i < 6; ++i) {
    gains.stiffness[i] = stiffness[i];
    gains.damping[i] = 2.0 * ratio * std::sqrt(stiffness[i] * inertia[i]);
    gains.error_clip[i] = clip[i];
  }
  for (int i = 0; i < 7; ++i) gains.posture[i] = posture[i];
  gains.posture_stiffness = section.number("posture_stiffness", 0.0, 100.0);
  gains.posture_torque_limit = section.number("posture_torque_limit", 0.0, 20.0);
  section.finish();
  return gains;
}

JointVector CartesianImpedance::torque(const ArmState& arm,
                                       const PoseReference& reference) const noexcept {
  // Spring on the clipped error, damper on the velocity error.
  const Twist error =
      minus(reference.X_WE, arm.X_WE).cwiseMax(-gains_.error_clip).cwiseMin(gains_.error_clip);
  const Wrench wrench =
      gains_.stiffness.cwiseProduct(error) + gains_.damping.cwiseProduct(reference.V_WE - arm.V_WE);

  // Posture: spring with critical damping for a unit inertia, capped, then projected out of the
  // tool's motion.
  const JointVector spring = gains_.posture_stiffness * (gains_.posture - arm.q);
  const JointVector damper = 2.0 * std::sqrt(gains_.posture_stiffness) * arm.dq;
  const JointVector posture = (spring - damper)
                                  .cwiseMax(-gains_.posture_torque_limit)
                                  .cwiseMin(gains_.posture_torque_limit);
  const Wrench leak = damped_gram(arm.J).solve(arm.J.lazyProduct(posture));

  return arm.J.transpose().lazyProduct(wrench - leak) + posture + arm.coriolis;
}

Wrench external_wrench(const Jacobian& J, const JointVector& tau_external) noexcept {
  return damped_gram(J).solve(J.lazyProduct(tau_external));
}

}  // namespace tandem
