#pragma once

#include <vector>

#include "controller/chunk/chunk.h"
#include "controller/law/arm_model.h"

/// The test path of the tracking figures, in free space above the table:
///
///   p(s) = p_0 + (0.10 sin(2 pi s / 8), 0.10 sin(2 pi 3 s / 16), 0.05 sin(2 pi s / 4)) m
///   R(s) = exp(0.2 sin(2 pi 3 s / 16), 0, 0.8 sin(2 pi s / 8)) R_0 rad, base axes
///
/// for s from 0 to 16 s: a Lissajous figure that closes, with yaw and a tilt. s runs up to the
/// speed of time within the first second and down again within the last, so the path takes 17 s and
/// begins and ends at rest. Fastest: 0.12 m/s on an axis, 0.63 rad/s.
namespace tandem::bench {

inline constexpr double kPathSeconds = 17.0;
inline constexpr double kHoldSeconds = 1.0;  ///< at its end, for the steady error
inline constexpr int kTicksPerStep = 100;    ///< commands come at 10 Hz
inline constexpr int kSteps = 180;           ///< of path and hold

/// p_0 = (0.5, 0, 0.3) m, tool straight down.
Pose path_start();

/// X_WE on the path, `seconds` after its beginning; before and after it its ends.
Pose path(double seconds);

/// Action limits of the commands, m and rad per step, as the peg task's on every axis.
Twist action_limit();

/// The commands: the way from one step's pose to the next, in units of the limits.
std::vector<Action> path_actions();

}  // namespace tandem::bench
