#include "controller/task/square.h"

#include <cmath>

namespace tandem {
namespace {

constexpr double kHandleWidth = 0.03175;  // m, models/square*/scene.xml
constexpr double kFingersOff = 0.004;     // m, from its width

double yaw_of(const Eigen::Quaterniond& R) { return log_map(R).z(); }

}  // namespace

SquareTask::SquareTask(Section& section) : Task(section) {
  X_WB_nominal_ = read_place(section, "nut_center_m");
  X_WG_nominal_ = read_place(section, "peg_top_m");
  const Pose start = read_place(section, "start_m");
  Section reset = section.section("reset");
  // The handle is taken as it lies; beyond 90 degrees the wrist would run out of turn.
  nut_ = read_spread(reset.section("nut"), 90.0);
  peg_ = read_spread(reset.section("peg"));
  start_ = read_spread(reset.section("start"));
  reset.finish();
  Section success = section.section("success");
  lateral_m_ = success.number("lateral_m", 0.0001, 0.05);
  height_m_ = success.number("height_m", 0.0005, 0.1);
  hand_away_m_ = success.number("hand_away_m", 0.0, 0.2);
  success.finish();

  spec_.X_W_origin = pointing_down(start.p);
  spec_.X_HO.p << -0.066, 0.0, 0.010;  // between the sites `grasp` and `object` of the scene
  spec_.goal_depth = X_WG_nominal_.p.z();
  spec_.grasp_width = kHandleWidth;
  spec_.release = true;
  spec_.gripper_start = -1.0;
  observation_ = std::make_unique<Observation>(section, spec_);
}

void SquareTask::attach(Simulation& simulation) {
  nut_body_ = simulation.body("nut");
  peg_body_ = simulation.body("peg");
  object_site_ = simulation.site("object");
  goal_site_ = simulation.site("goal");
  grasp_site_ = simulation.site("grasp");
}

void SquareTask::reset(MujocoRobot& robot, ArmModel& arm, uint64_t episode_seed) {
  Random random = random_for(episode_seed, Purpose::reset);
  Simulation& simulation = robot.simulation();
  const Pose X_WG = add(X_WG_nominal_, peg_.draw(random));
  const Pose X_WB = add(X_WB_nominal_, nut_.draw(random));
  simulation.place_body(peg_body_, X_WG);
  place_arm(robot, arm, add(spec_.X_W_origin, start_.draw(random)), kGripperStroke);
  simulation.place_free_body(nut_body_, X_WB);
  simulation.forward();

  const double quarters = std::round(yaw_of(X_WB.R * X_WG.R.conjugate()) / (0.5 * M_PI));
  quarter_turns_ = exp_map(Eigen::Vector3d(0.0, 0.0, 0.5 * M_PI * quarters));
}

SceneTruth SquareTask::truth(const Simulation& simulation) const noexcept {
  Pose X_WG = simulation.site_pose(goal_site_);
  X_WG.R = X_WG.R * quarter_turns_;
  return {simulation.site_pose(object_site_), X_WG, simulation.site_pose(grasp_site_)};
}

bool SquareTask::succeeded(const SceneTruth& truth, const Simulation& simulation) noexcept {
  const Pose X_GO = inverse(truth.X_WG) * truth.X_WO;
  const bool placed = std::abs(X_GO.p.x()) <= lateral_m_ && std::abs(X_GO.p.y()) <= lateral_m_ &&
                      X_GO.p.z() + spec_.goal_depth <= height_m_;
  // Wider than the handle, or closed upon nothing.
  const bool fingers_off =
      std::abs(simulation.finger_position().sum() - kHandleWidth) > kFingersOff;
  const double away = (simulation.tool_pose().p - truth.X_WH.p).norm();
  return placed && fingers_off && away >= hand_away_m_;
}

}  // namespace tandem
