#include "controller/task/reset.h"

#include <cmath>
#include <vector>

namespace tandem {

Twist Spread::draw(Random& random) const {
  Twist d = Twist::Zero();
  d[0] = random.uniform(-xy_m, xy_m);
  d[1] = random.uniform(-xy_m, xy_m);
  d[2] = random.uniform(-z_m, z_m);
  d[5] = random.uniform(-yaw_rad, yaw_rad);
  return d;
}

Spread read_spread(Section section, double widest_yaw_deg) {
  const Spread spread{section.number("xy_m", 0.0, 0.2), section.number("z_m", 0.0, 0.1),
                      section.number("yaw_deg", 0.0, widest_yaw_deg) * M_PI / 180.0};
  section.finish();
  return spread;
}

Pose read_place(Section& section, const std::string& key) {
  const std::vector<double> p = section.numbers(key, 3, -1.0, 1.0);
  return {{p[0], p[1], p[2]}, Eigen::Quaterniond::Identity()};
}

Pose pointing_down(const Eigen::Vector3d& p) {
  return {p, Eigen::Quaterniond(Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitX()))};
}

void place_arm(MujocoRobot& robot, ArmModel& arm, const Pose& X_WE, double gripper_width) {
  JointVector home;
  home << 0.0, -M_PI / 4, 0.0, -3 * M_PI / 4, 0.0, M_PI / 2, M_PI / 4;
  robot.place(arm.solve_ik(X_WE, home), gripper_width);
}

}  // namespace tandem
