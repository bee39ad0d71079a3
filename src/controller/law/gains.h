#pragma once

#include <string>
#include <tandem/impedance_gains_t.hpp>

#include "base/geometry.h"
#include "base/section.h"

namespace tandem {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// Gains of the impedance law. Rows: translation x y z, then rotation x y z, in base axes or the
/// tool's.
struct ImpedanceGains {
  bool tool_axes = false;               ///< stiffness, damping and clip are in the axes of E
  Matrix6 stiffness = Matrix6::Zero();  ///< N/m ... N m/rad; symmetric, positive semi-definite
  Matrix6 damping = Matrix6::Zero();    ///< N s/m ... N m s/rad; symmetric, positive semi-definite
  Twist clip_low = Twist::Zero();   ///< m, rad, >= 0: the error counts as no less than -clip_low
  Twist clip_high = Twist::Zero();  ///< m, rad, >= 0: ... and as no more than clip_high
  Twist apparent_inertia = Twist::Zero();  ///< kg, kg m^2: what damping by ratio takes for the arm
  JointVector posture = JointVector::Zero();  ///< rad, where the null space is pulled to
  double posture_stiffness = 0.0;             ///< N m/rad
  double posture_torque_limit = 0.0;          ///< N m per joint
};

/// Largest gains on the diagonal that a 1 kHz loop keeps stable on this arm: one tick of damping
/// takes less than the whole speed of the lightest direction. PSD matrices need no other bound.
namespace gain_limit {
inline constexpr double kStiffness = 6000.0;        ///< N/m
inline constexpr double kAngularStiffness = 600.0;  ///< N m/rad
inline constexpr double kDamping = 1000.0;          ///< N s/m
inline constexpr double kAngularDamping = 50.0;     ///< N m s/rad
inline constexpr double kDampingRatio = 3.0;
inline constexpr double kClip = 0.5;  ///< m, rad
}  // namespace gain_limit

/// Reads and checks the `law` section of controller.yaml. Stiffness and damping: 6 numbers, one per
/// axis, or 36, a full matrix row by row. Either `damping_ratio` or `damping`; either `error_clip`
/// for both signs or `error_clip_low` and `error_clip_high`. @throws ScenarioError
ImpedanceGains read_gains(Section section);

/// Damping for a stiffness: 2 ratio sqrt(M) sqrt(sqrt(M)^-1 K sqrt(M)^-1) sqrt(M), which for
/// diagonal K is 2 ratio sqrt(k m) per axis. `inertia` is diagonal, kg, kg m^2, in the axes of K.
Matrix6 damping_from_ratio(const Matrix6& stiffness, const Twist& inertia, double ratio);

/// Gains that came over the wire, on top of the present ones (posture and apparent inertia stay).
/// @returns empty when they are good and `gains` is filled, else a clause that says what is wrong,
/// with value and limit, and `gains` is untouched. Not real-time: called by the link thread.
std::string gains_from(const impedance_gains_t& message, const ImpedanceGains& present,
                       ImpedanceGains& gains);

/// What is logged when gains come into force: always with the damping matrix, never with a ratio.
impedance_gains_t to_message(const ImpedanceGains& gains, int64_t utime);

}  // namespace tandem
