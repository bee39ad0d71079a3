#pragma once

#include "base/geometry.h"
#include "base/section.h"
#include "controller/law/arm_model.h"

namespace tandem {

/// Gains of the impedance law, in base axes: translation x y z, then rotation x y z.
struct ImpedanceGains {
  Twist stiffness = Twist::Zero();  ///< N/m, N m/rad
  Twist damping = Twist::Zero();    ///< N s/m, N m s/rad
  Twist error_clip =
      Twist::Zero();  ///< m, rad: the largest error per axis and sign that the stiffness acts on
  JointVector posture = JointVector::Zero();  ///< rad, where the null space is pulled to
  double posture_stiffness = 0.0;             ///< N m/rad
  double posture_torque_limit = 0.0;          ///< N m per joint
};

/// What the law tracks: pose and velocity of the tool in base axes.
struct PoseReference {
  Pose X_WE;
  Twist V_WE = Twist::Zero();
};

/// Reads and checks the `law` section of controller.yaml. @throws ScenarioError
ImpedanceGains read_gains(Section section);

/// Cartesian impedance law with a bounded contact force.
///
///   tau = J' (K clip(e) + D (V_ref - V)) + N tau_posture + c(q, dq)
///
/// e = (p_ref - p, log(R_ref R')) in base axes. Because e is clipped per axis and sign before K
/// acts, the static force on the tool never exceeds K clip; force_bound() reports it. N = I - J' (J
/// J' + lambda^2 I)^-1 J keeps the posture task out of the tool's motion and stays bounded at
/// singularities. Gravity is the robot's own business.
///
/// Real-time: no allocation, no lock, noexcept.
class CartesianImpedance {
 public:
  explicit CartesianImpedance(const ImpedanceGains& gains) : gains_(gains) {}

  JointVector torque(const ArmState& arm, const PoseReference& reference) const noexcept;

  /// Largest static force and moment per base axis, N and N m.
  Wrench force_bound() const noexcept { return gains_.stiffness.cwiseProduct(gains_.error_clip); }

  const ImpedanceGains& gains() const noexcept { return gains_; }

 private:
  ImpedanceGains gains_;
};

/// Force and moment on the tool (base axes) that explain the external joint torques: least squares
/// of J' F = tau_external, damped like N above. Real-time.
Wrench external_wrench(const Jacobian& J, const JointVector& tau_external) noexcept;

}  // namespace tandem
