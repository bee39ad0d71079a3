#pragma once

#include "base/section.h"

namespace tandem {

/// What the silence of a source has come to. Values as in controller_status_t.source_grade.
enum class Grade : int8_t {
  fresh = 0,
  hold = 1,  ///< the source asks for no motion: the commanded pose stands
  damp = 2,  ///< the stiffness fades: the arm yields and moves only against damping
  stop = 3,  ///< a fault; the robot stops
};

/// Ages, in ms since a source was last heard, at which the answer to its silence changes.
struct WatchdogLimits {
  double hold_after_ms = 0.0, damp_after_ms = 0.0, stop_after_ms = 0.0;

  /// Real-time. A NaN is taken as silence.
  Grade grade(double age_ms) const noexcept {
    if (age_ms <= hold_after_ms) return Grade::fresh;
    if (age_ms <= damp_after_ms) return Grade::hold;
    if (age_ms <= stop_after_ms) return Grade::damp;
    return Grade::stop;
  }
};

/// The `watchdog` section: how long policy, operator and link may be silent.
///
/// Ages are receive ages on the controller's monotonic clock; a sender's clock plays no part. In
/// lockstep simulated time is that clock.
struct WatchdogSettings {
  WatchdogLimits policy;     ///< while it is in charge: since an action was last due
  WatchdogLimits operator_;  ///< while he is engaged: since his last command
  /// Then he has let go, if there is a policy to hand back to.
  double operator_release_after_ms = 0.0;
  WatchdogLimits link;  ///< real time: since the link thread was last alive
};

/// @throws ScenarioError also when hold, damp and stop do not follow each other.
WatchdogSettings read_watchdog(Section section);

}  // namespace tandem
