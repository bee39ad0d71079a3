#pragma once

#include "base/section.h"
#include "controller/law/cartesian_impedance.h"

namespace tandem {

/// The `reference` section. Limits hold for the length of the translational and of the rotational
/// part.
struct ReferenceSettings {
  double omega = 0.0;                 ///< rad/s, bandwidth
  double velocity_linear = 0.0;       ///< m/s
  double velocity_angular = 0.0;      ///< rad/s
  double acceleration_linear = 0.0;   ///< m/s^2
  double acceleration_angular = 0.0;  ///< rad/s^2
};

/// @throws ScenarioError also when an acceleration limit is too small to brake from the velocity
/// limit without overshoot.
ReferenceSettings read_reference(Section section);

/// Turns the commanded pose, which moves in straight ramps from step to step, into a reference that
/// is continuous in pose and velocity whatever the commanded pose does: seams between chunks,
/// take-overs and even jumps included.
///
/// A critically damped second-order low-pass on SE(3), base axes: a = omega^2 e - 2 omega V with e
/// = commanded minus reference. It never overshoots a ramp that stops and lags a steady ramp by 2 /
/// omega seconds, which the velocity feed-forward of the law makes up for. Acceleration and
/// velocity are cut in length, so a cut motion keeps its direction; nothing is cut in the motions
/// that a task can ask for. With the default limits no tick moves the reference by more than 0.5 mm
/// and 1.5 mrad.
///
/// While the law is damped: let the commanded pose stand until the law's stiffness is gone, then
/// set it to the measured pose every tick. The reference goes after the arm under the same limits,
/// and the stiffness comes back from there without a jump.
///
/// Real-time: no allocation, no lock, noexcept.
class ReferenceFilter {
 public:
  explicit ReferenceFilter(const ReferenceSettings& settings) : settings_(settings) {}

  /// Starts at rest at X_WE: an episode begins, or a fault was cleared.
  void reset(const Pose& X_WE) noexcept;

  /// One tick of 1 ms towards the commanded pose.
  const PoseReference& step(const Pose& X_WE_commanded) noexcept;

  const PoseReference& reference() const noexcept { return reference_; }

 private:
  ReferenceSettings settings_;
  PoseReference reference_;
};

}  // namespace tandem
