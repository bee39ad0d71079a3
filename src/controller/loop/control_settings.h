#pragma once

#include "controller/camera/camera_settings.h"
#include "controller/chunk/reference_filter.h"
#include "controller/law/gains.h"
#include "controller/robot/mujoco_robot.h"
#include "controller/safety/safety_filter.h"
#include "controller/safety/watchdog.h"

namespace tandem {

/// Right of the control thread to the machine, real time only.
struct RealtimeSettings {
  int priority = 80;  ///< SCHED_FIFO
  int core = -1;      ///< the control thread stays on this core; -1 = anywhere
};

/// The `controller` section of the scenario. Units and reasons: config/controller.yaml.
struct ControlSettings {
  ImpedanceGains gains;
  ReferenceSettings reference;
  int ramp_in_ticks = 1, ramp_out_ticks = 1;
  WatchdogSettings watchdog;
  SafetySettings safety;
  MujocoRobotOptions robot;
  int faults_in_a_row = 5;       ///< episodes in a row that may end in a fault before the run does
  double force_filter_hz = 0.0;  ///< cut-off of the wrench that observation and operator see
  CameraSettings camera;
  RealtimeSettings realtime;
};

/// @throws ScenarioError
ControlSettings read_control(Section section);

}  // namespace tandem
