#pragma once

#include "controller/chunk/reference_filter.h"
#include "controller/robot/robot_options.h"
#include "controller/safety/safety_filter.h"
#include "tracking_path.h"

namespace tandem::bench {

inline constexpr int kHorizon = 8, kExecute = 4;  ///< chunks as a policy would give them, open loop
inline constexpr double kLever = 0.1;             ///< m, along x, from the tool to the unknown load

/// What is changed about the controller; see tracking.cpp.
enum class Variant { ours, measured_anchor, half_rotation };

/// Distance of the arm from the path, m and rad.
struct Tracking {
  double position_rms = 0.0, position_max = 0.0, position_steady = 0.0;
  double rotation_rms = 0.0, rotation_max = 0.0, rotation_steady = 0.0;
  double delayed_position_rms = 0.0;  ///< against the path 2 / omega earlier: its shape
  double delayed_rotation_rms = 0.0;
};

/// Parts of config/controller.yaml that lie between chunk and robot.
struct TrackingSettings {
  ImpedanceGains gains;
  SafetySettings safety;
  ReferenceSettings reference;
  MujocoRobotOptions robot;
};

/// @throws ScenarioError
TrackingSettings read_tracking(Section controller);

/// Plays the path's commands on a simulated arm. @param models folder of that name. @param load N,
/// weight of a load that the robot does not know. @throws std::runtime_error if the robot stops.
Tracking follow_path(Variant variant, const TrackingSettings& settings, double load,
                     const std::string& models);

}  // namespace tandem::bench
