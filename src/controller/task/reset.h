#pragma once

#include <string>

#include "base/geometry.h"
#include "base/random.h"
#include "base/section.h"
#include "controller/law/arm_model.h"
#include "controller/robot/mujoco_robot.h"

/// What tasks share when they put arm and scene where an episode begins. Not real-time.
namespace tandem {

/// Half-widths of uniform distributions about a nominal pose.
struct Spread {
  double xy_m, z_m, yaw_rad;

  /// A change of pose in base axes, for add().
  Twist draw(Random& random) const;
};

/// Keys xy_m, z_m and yaw_deg; yaw up to `widest_yaw_deg`. @throws ScenarioError
Spread read_spread(Section section, double widest_yaw_deg = 45.0);

/// Key with a position in base axes, m, each in [-1, 1]: a pose there, not turned. @throws
/// ScenarioError
Pose read_place(Section& section, const std::string& key);

/// Upside down about x: a tool at p that points down, without yaw.
Pose pointing_down(const Eigen::Vector3d& p);

/// Puts the tool at X_WE, by the posture nearest to the arm's usual one, and the fingers
/// `gripper_width` m apart. @throws std::runtime_error when the arm can't reach it.
void place_arm(MujocoRobot& robot, ArmModel& arm, const Pose& X_WE, double gripper_width);

}  // namespace tandem
