#pragma once

#include <Eigen/Dense>

/// Fixed-size types that the control loop shares. None of them allocates.
///
/// Frames: W robot base, z up; E tool centre point between the finger tips, z along the approach; F
/// flange. X_AB is the pose of B in A; p_AB its position; V_WE = (linear, angular) velocity of E in
/// W axes.
namespace tandem {

using JointVector = Eigen::Matrix<double, 7, 1>;  ///< rad, rad/s or N m; joint 1 first
using JointMatrix = Eigen::Matrix<double, 7, 7>;  ///< kg m^2
using Jacobian = Eigen::Matrix<double, 6, 7>;  ///< V_WE = J dq; rows: linear x y z, angular x y z
using Twist = Eigen::Matrix<double, 6, 1>;     ///< linear (m/s or m) then angular (rad/s or rad)
using Wrench = Eigen::Matrix<double, 6, 1>;    ///< force (N) then moment (N m)

struct Pose {
  Eigen::Vector3d p = Eigen::Vector3d::Zero();            ///< m
  Eigen::Quaterniond R = Eigen::Quaterniond::Identity();  ///< unit; w x y z on the wire, w >= 0
};

/// X_AC = X_AB X_BC.
inline Pose operator*(const Pose& a, const Pose& b) {
  return {a.p + a.R * b.p, (a.R * b.R).normalized()};
}

/// X_BA from X_AB.
inline Pose inverse(const Pose& a) { return {a.R.conjugate() * -a.p, a.R.conjugate()}; }

/// Rotation vector of R: axis times angle, the angle in [0, pi].
inline Eigen::Vector3d log_map(const Eigen::Quaterniond& R) {
  const Eigen::Quaterniond q = R.w() < 0 ? Eigen::Quaterniond(-R.coeffs()) : R;
  const double sine = q.vec().norm();
  if (sine < 1e-9) return 2.0 * q.vec();
  return q.vec() * (2.0 * std::atan2(sine, q.w()) / sine);
}

/// Inverse of log_map().
inline Eigen::Quaterniond exp_map(const Eigen::Vector3d& rotation_vector) {
  const double angle = rotation_vector.norm();
  if (angle < 1e-12) {
    return Eigen::Quaterniond(1.0, 0.5 * rotation_vector.x(), 0.5 * rotation_vector.y(),
                              0.5 * rotation_vector.z())
        .normalized();
  }
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, rotation_vector / angle));
}

/// b minus a in base axes: (p_b - p_a, log(R_b R_a')). add(a, minus(b, a)) is b.
inline Twist minus(const Pose& b, const Pose& a) {
  Twist d;
  d << b.p - a.p, log_map(b.R * a.R.conjugate());
  return d;
}

/// a moved by a small displacement d = (translation, rotation vector) in base axes.
inline Pose add(const Pose& a, const Twist& d) {
  return {a.p + d.head<3>(), (exp_map(d.tail<3>()) * a.R).normalized()};
}

}  // namespace tandem
