#pragma once

#include "controller/law/cartesian_impedance.h"

namespace tandem {

/// Turns the commanded pose, which moves in straight ramps from step to step, into a reference that
/// is continuous in pose and velocity whatever the commanded pose does: seams between chunks and
/// take-overs included.
///
/// A critically damped second-order low-pass on SE(3), base axes: a = omega^2 e - 2 omega V with e
/// = commanded minus reference. It never overshoots a ramp that stops and lags a steady ramp by 2 /
/// omega seconds, which the velocity feed-forward of the law makes up for. Real-time.
class ReferenceFilter {
 public:
  /// @param omega rad/s. @param acceleration_limit m/s^2 and rad/s^2 per axis.
  ReferenceFilter(double omega, const Twist& acceleration_limit)
      : omega_(omega), acceleration_limit_(acceleration_limit) {}

  /// Starts at rest at X_WE.
  void reset(const Pose& X_WE) noexcept { reference_ = {X_WE, Twist::Zero()}; }

  /// One tick of 1 ms towards the commanded pose.
  const PoseReference& step(const Pose& X_WE_commanded) noexcept {
    constexpr double kDt = 0.001;
    const Twist error = minus(X_WE_commanded, reference_.X_WE);
    const Twist acceleration = (omega_ * omega_ * error - 2.0 * omega_ * reference_.V_WE)
                                   .cwiseMax(-acceleration_limit_)
                                   .cwiseMin(acceleration_limit_);
    reference_.V_WE += kDt * acceleration;
    reference_.X_WE = add(reference_.X_WE, kDt * reference_.V_WE);
    return reference_;
  }

  const PoseReference& reference() const noexcept { return reference_; }

 private:
  double omega_;
  Twist acceleration_limit_;
  PoseReference reference_;
};

}  // namespace tandem
