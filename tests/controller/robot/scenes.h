#pragma once

#include <string>

#include "controller/law/arm_model.h"
#include "controller/robot/mujoco_robot.h"

namespace tandem::testing {

inline const std::string kModels = TANDEM_MODELS;
inline const std::string kArmScene = kModels + "/arm/scene.xml";
inline const std::string kPegScene = kModels + "/peg/scene.xml";
inline const std::string kUrdf = kModels + "/panda/panda.urdf";
inline constexpr double kPegWidth = 0.02;  // m, between the fingers

/// Tool down, in the middle of the workspace.
inline JointVector home() {
  JointVector q;
  q << 0, -0.785398163397448, 0, -2.356194490192345, 0, 1.570796326794897, 0.785398163397448;
  return q;
}

/// E such that the peg's tip (60 mm beyond E, tool pointing down) is at p_WT.
inline Pose tool_over(const Eigen::Vector3d& p_WT) {
  return {p_WT + Eigen::Vector3d(0, 0, 0.06), Eigen::Quaterniond(0, 1, 0, 0)};
}

}  // namespace tandem::testing
