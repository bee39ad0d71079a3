#include "controller/task/peg.h"

#include <cmath>

#include "controller/robot/hole.h"

namespace tandem {
namespace {

constexpr double kTipDistance = 0.06;  // m, tip of the peg beyond E, models/peg/tool.xml
constexpr double kHoleDepth = 0.03;    // m, models/peg/scene.xml

}  // namespace

PegTask::PegTask(Section& section) : Task(section) {
  const std::string difficulty = section.choice("difficulty", {"normal", "hard"});
  Section clearance = section.section("clearance_m");
  for (const char* name : {"normal", "hard"}) {
    const double value = clearance.number(name, 0.00005, 0.002);
    if (name == difficulty) clearance_m_ = value;
  }
  clearance.finish();
  success_depth_m_ = section.number("success_depth_m", 0.001, 0.0299);
  gripper_width_m_ = section.number("gripper_width_m", 0.0, 0.08);
  X_WG_nominal_ = read_place(section, "hole_center_m");
  const double height = section.number("start_height_m", 0.005, 0.3);
  Section reset = section.section("reset");
  hole_ = read_spread(reset.section("hole"));
  start_ = read_spread(reset.section("start"));
  in_hand_ = read_spread(reset.section("in_hand"));
  tilt_rad_ = reset.number("in_hand_tilt_deg", 0.0, 10.0) * M_PI / 180.0;
  reset.finish();

  spec_.X_HO.p << 0.0, 0.0, kTipDistance;
  spec_.goal_depth = kHoleDepth;
  spec_.X_W_origin =
      pointing_down(X_WG_nominal_.p + Eigen::Vector3d(0.0, 0.0, height + kTipDistance));
  observation_ = std::make_unique<Observation>(section, spec_);
}

void PegTask::attach(Simulation& simulation) {
  peg_body_ = simulation.body("peg");
  hole_body_ = simulation.body("hole");
  tip_site_ = simulation.site("object");
  rim_site_ = simulation.site("goal");
  set_hole_clearance(simulation, clearance_m_);
}

void PegTask::reset(MujocoRobot& robot, ArmModel& arm, uint64_t episode_seed) {
  Random random = random_for(episode_seed, Purpose::reset);
  Simulation& simulation = robot.simulation();

  simulation.place_body(hole_body_, add(X_WG_nominal_, hole_.draw(random)));

  // In-hand error: the peg sits off centre, turned and tilted between the fingers; the policy is
  // not told.
  Twist error = in_hand_.draw(random);
  error[3] = random.uniform(-tilt_rad_, tilt_rad_);
  error[4] = random.uniform(-tilt_rad_, tilt_rad_);
  simulation.place_body(peg_body_, simulation.hand_to_tool() * add(Pose{}, error));

  place_arm(robot, arm, add(spec_.X_W_origin, start_.draw(random)), gripper_width_m_);
}

SceneTruth PegTask::truth(const Simulation& simulation) const noexcept {
  return {simulation.site_pose(tip_site_), simulation.site_pose(rim_site_), simulation.tool_pose()};
}

bool PegTask::succeeded(const SceneTruth& truth, const Simulation&) noexcept {
  const Pose X_GO = inverse(truth.X_WG) * truth.X_WO;
  const double side = clearance_m_ + 0.001;
  return -X_GO.p.z() >= success_depth_m_ && std::abs(X_GO.p.x()) <= side &&
         std::abs(X_GO.p.y()) <= side;
}

}  // namespace tandem
