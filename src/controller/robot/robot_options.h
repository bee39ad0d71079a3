#pragma once

#include "base/section.h"
#include "controller/robot/fault_injection.h"

namespace tandem {

/// What can be chosen about the simulated robot: the section `controller.robot`. The defaults here
/// are those of config/controller.yaml, where the reasons are.
struct MujocoRobotOptions {
  // External torque and force, averaged over 20 ms, beyond which RobotState says contact, and
  // beyond which the robot stops with Fault::collision (Franka's setCollisionBehavior).
  JointVector contact_torque = (JointVector() << 5, 5, 5, 5, 2, 2, 2).finished();  ///< N m
  JointVector collision_torque = JointVector::Constant(40.0);                      ///< N m
  Wrench contact_force = (Wrench() << 5, 5, 5, 1, 1, 1).finished();  ///< N, N m, base axes
  Wrench collision_force =
      (Wrench() << 100, 100, 100, 40, 40, 40).finished();  ///< N, N m, base axes

  double gripper_speed = 0.1;    ///< m/s, of the width, (0, 1]
  double gripper_force = 40.0;   ///< N, largest force of each finger, (0, 140]
  int gripper_latency_ms = 200;  ///< from grip() until the fingers follow, 0 to 500

  Injection inject;  ///< nothing by default
};

/// Longest gripper_latency_ms.
inline constexpr int kLongestGripperLatencyMs = 500;

/// @throws ScenarioError also when a collision threshold is below its contact threshold.
MujocoRobotOptions read_robot(Section section);

/// @throws std::invalid_argument naming the option, its value and its range.
void check(const MujocoRobotOptions& options);

}  // namespace tandem
