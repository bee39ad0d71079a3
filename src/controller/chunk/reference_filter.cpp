#include "controller/chunk/reference_filter.h"

namespace tandem {
namespace {

constexpr double kDt = 0.001;  // s, a tick

/// Shortens translation and rotation to their limits; what is within them stays as it is, to the
/// bit.
void shorten(Twist& v, double linear_limit, double angular_limit) noexcept {
  const double linear = v.head<3>().norm(), angular = v.tail<3>().norm();
  if (linear > linear_limit) v.head<3>() *= linear_limit / linear;
  if (angular > angular_limit) v.tail<3>() *= angular_limit / angular;
}

/// Braking from `velocity` without overshoot takes omega velocity / e of acceleration.
double read_acceleration(Section& section, const std::string& key, double high, double omega,
                         double velocity) {
  constexpr double kE = 2.718281828459045;
  const double acceleration = section.number(key, 0.1, high), needed = omega * velocity / kE;
  if (acceleration < needed) {
    throw ScenarioError(section.place(key) + " is " + std::to_string(acceleration) +
                        "; it must be at least " + std::to_string(needed) +
                        " (omega_rad_s times the velocity limit / e), or the reference overshoots. "
                        "Raise it or lower the other two.");
  }
  return acceleration;
}

}  // namespace

ReferenceSettings read_reference(Section section) {
  ReferenceSettings settings;
  settings.omega = section.number("omega_rad_s", 10.0, 500.0);
  settings.velocity_linear = section.number("velocity_limit_m_s", 0.01, 0.5);
  settings.velocity_angular = section.number("velocity_limit_rad_s", 0.01, 2.5);
  settings.acceleration_linear = read_acceleration(section, "acceleration_limit_m_s2", 100.0,
                                                   settings.omega, settings.velocity_linear);
  settings.acceleration_angular = read_acceleration(section, "acceleration_limit_rad_s2", 1000.0,
                                                    settings.omega, settings.velocity_angular);
  section.finish();
  return settings;
}

void ReferenceFilter::reset(const Pose& X_WE) noexcept { reference_ = {X_WE, Twist::Zero()}; }

const PoseReference& ReferenceFilter::step(const Pose& X_WE_commanded) noexcept {
  const double omega = settings_.omega;
  const Twist error = minus(X_WE_commanded, reference_.X_WE);
  Twist acceleration = omega * omega * error - 2.0 * omega * reference_.V_WE;
  shorten(acceleration, settings_.acceleration_linear, settings_.acceleration_angular);
  reference_.V_WE += kDt * acceleration;
  shorten(reference_.V_WE, settings_.velocity_linear, settings_.velocity_angular);
  reference_.X_WE = add(reference_.X_WE, kDt * reference_.V_WE);
  return reference_;
}

}  // namespace tandem
