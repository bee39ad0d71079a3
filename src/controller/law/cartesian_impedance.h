#pragma once

#include "base/geometry.h"
#include "controller/law/arm_model.h"
#include "controller/law/gains.h"

namespace tandem {

/// What the law tracks: pose and velocity of the tool in base axes.
struct PoseReference {
  Pose X_WE;
  Twist V_WE = Twist::Zero();
};

/// Cartesian impedance law with a bounded contact force.
///
///   tau = J' (K clip(e) + D (V_ref - V)) + N tau_posture - d_singular dq + c(q, dq)
///
/// e = (p_ref - p, log(R_ref R')) in base axes, or turned into the tool's when the gains say so.
/// Because e is clipped per axis and sign before K acts, the static force on the tool never exceeds
/// what force_bound() reports. N = I - J' (J J' + lambda^2 I)^-1 J keeps the posture task out of
/// the tool's motion and stays bounded at singularities; d_singular grows as the smallest singular
/// values of J fall, and is exactly zero away from singularities. Gravity is the robot's own
/// business.
///
/// With a diagonal K the clipped spring has a potential, so it gives back no more than it took;
/// coupled axes that are clipped have none, and rely on D.
///
/// Real-time: no allocation, no lock, noexcept.
class CartesianImpedance {
 public:
  static constexpr int kRampTicks = 200;  ///< new gains are reached after so long
  static constexpr int kFadeTicks = 300;  ///< stiffness is gone, or back, after so long

  explicit CartesianImpedance(const ImpedanceGains& gains) : gains_(gains) {}

  /// Start of an episode: gains in force are the latest ones, nothing is faded.
  void reset() noexcept;

  /// New gains. The wrench goes from that of the old gains to that of the new ones in a straight
  /// ramp, so it holds for changed axes and full matrices, too. Gains that come during a ramp wait
  /// for its end; of several the latest is taken.
  void set_gains(const ImpedanceGains& gains) noexcept;

  /// While `damped`, the stiffness (posture and velocity feed-forward included) fades and the arm
  /// moves against damping only.
  void set_damped(bool damped) noexcept { damped_ = damped; }

  /// One tick: advances the ramps. @returns N m.
  JointVector torque(const ArmState& arm, const PoseReference& reference) noexcept;

  /// Largest static force and moment of the spring per base axis, either sign, with the tool at
  /// orientation R_WE, N and N m, in the state of ramp and fade of the latest tick.
  Wrench force_bound(const Eigen::Quaterniond& R_WE) const noexcept;

  /// The part of `increment` (m, rad, base axes) by which a commanded pose that leads the measured
  /// one by `lead` may move on, so that no axis (of the gains) leads by more than its clip. A lead
  /// that is there already is left alone.
  Twist allowed(const Twist& increment, const Twist& lead,
                const Eigen::Quaterniond& R_WE) const noexcept;

  /// In force, or being ramped to.
  const ImpedanceGains& gains() const noexcept { return gains_; }
  bool ramping() const noexcept { return ramp_left_ > 0; }
  /// 1: the full stiffness, 0: damping only.
  double stiffness_share() const noexcept { return 1.0 - fade_ / double(kFadeTicks); }

 private:
  double ramped() const noexcept { return 1.0 - ramp_left_ / double(kRampTicks); }

  ImpedanceGains gains_, from_, next_;
  int ramp_left_ = 0;
  bool has_next_ = false;
  bool damped_ = false;
  int fade_ = 0;  // ticks: 0 stiff, kFadeTicks damped
};

/// Force and moment on the tool (base axes) that explain the external joint torques: least squares
/// of J' F = tau_external, damped like N above. Real-time.
Wrench external_wrench(const Jacobian& J, const JointVector& tau_external) noexcept;

}  // namespace tandem
