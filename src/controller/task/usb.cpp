#include "controller/task/usb.h"

#include <algorithm>

#include "controller/robot/leds.h"

namespace tandem {
namespace {

// m, models/usb/scene.xml.
constexpr double kGraspFromTip = 0.02735;  // finger tips 4 mm off the flange
constexpr double kHousingWidth = 0.0145;
constexpr double kPortDepth = 0.009;
constexpr double kUnderPanel = 0.03;  // what closes the wanted port lies so deep, out of the way

const std::vector<std::string> kPorts = {"usb1", "usb2", "usb3", "usb4"};

}  // namespace

UsbTask::UsbTask(Section& section) : Task(section) {
  for (const std::string& name : section.texts("ports")) {
    if (std::find(kPorts.begin(), kPorts.end(), name) == kPorts.end()) {
      throw ScenarioError(section.place("ports") + " names '" + name +
                          "'; the panel has usb1, usb2, usb3 and usb4.");
    }
    ports_.push_back({.name = name, .body = -1, .X_PG = {}});
  }
  if (ports_.empty()) {
    throw ScenarioError(section.place("ports") +
                        " is empty; it must name one of usb1, usb2, usb3, usb4 or more.");
  }
  X_WP_nominal_ = read_place(section, "panel_center_m");
  X_WS_nominal_ = read_place(section, "stand_top_m");
  const Pose start = read_place(section, "start_m");
  Section reset = section.section("reset");
  panel_ = read_spread(reset.section("panel"));
  stand_ = read_spread(reset.section("stand"));
  start_ = read_spread(reset.section("start"));
  reset.finish();
  Section success = section.section("success");
  depth_m_ = success.number("depth_m", 0.001, kPortDepth);
  lateral_m_ = success.number("lateral_m", 0.0001, 0.005);
  hold_steps_ = static_cast<int>(success.integer("hold_steps", 1, 1000));
  success.finish();

  // The fingers take the housing by its narrow sides: a quarter turn between hand and plug.
  const Eigen::Quaterniond quarter(Eigen::AngleAxisd(0.5 * M_PI, Eigen::Vector3d::UnitZ()));
  spec_.X_W_origin = pointing_down(start.p);
  spec_.X_W_origin.R = spec_.X_W_origin.R * quarter.conjugate();
  spec_.X_HO = {{0.0, 0.0, kGraspFromTip}, quarter};
  spec_.goal_depth = kPortDepth;
  spec_.insertion_force = section.number("insertion_force_N", 0.0, 35.0);
  spec_.grasp_width = kHousingWidth;
  spec_.gripper_start = -1.0;
  observation_ = std::make_unique<Observation>(section, spec_);
}

void UsbTask::attach(Simulation& simulation) {
  plug_body_ = simulation.body("plug");
  panel_body_ = simulation.body("panel");
  port_body_ = simulation.body("port");
  stand_body_ = simulation.body("stand");
  object_site_ = simulation.site("object");
  goal_site_ = simulation.site("goal");
  seat_site_ = simulation.site("seat");
  for (Port& port : ports_) {
    port.body = simulation.body(port.name);
    port.X_PG = simulation.placed_body(port.body);
  }
}

void UsbTask::stage(Simulation& simulation, uint64_t episode_seed) const {
  Random random = random_for(episode_seed, Purpose::reset);
  simulation.place_body(panel_body_, add(X_WP_nominal_, panel_.draw(random)));
  simulation.place_body(stand_body_, add(X_WS_nominal_, stand_.draw(random)));

  // The wanted port opens, the others are closed.
  const double draw = random.uniform(0.0, static_cast<double>(ports_.size()));
  const size_t wanted = std::min(static_cast<size_t>(draw), ports_.size() - 1);
  for (size_t i = 0; i < ports_.size(); ++i) {
    Pose X_PL = ports_[i].X_PG;
    if (i == wanted) {
      simulation.place_body(port_body_, X_PL);
      X_PL.p.z() -= kUnderPanel;
    }
    simulation.place_body(ports_[i].body, X_PL);
  }
  light_leds(simulation.model(), episode_seed);
  simulation.forward();
}

void UsbTask::reset(MujocoRobot& robot, ArmModel& arm, uint64_t episode_seed) {
  Random random = random_for(episode_seed, Purpose::reset, 1);
  Simulation& simulation = robot.simulation();
  held_steps_ = 0;
  stage(simulation, episode_seed);
  place_arm(robot, arm, add(spec_.X_W_origin, start_.draw(random)), kGripperStroke);
  simulation.place_free_body(plug_body_, simulation.site_pose(seat_site_));
  simulation.forward();
}

SceneTruth UsbTask::truth(const Simulation& simulation) const noexcept {
  const Pose X_WO = simulation.site_pose(object_site_);
  return {X_WO, simulation.site_pose(goal_site_), X_WO * inverse(spec_.X_HO)};
}

bool UsbTask::succeeded(const SceneTruth& truth, const Simulation&) noexcept {
  const Eigen::Vector3d p_GO = (inverse(truth.X_WG) * truth.X_WO).p;
  const bool seated = -p_GO.z() >= depth_m_ && p_GO.head<2>().norm() < lateral_m_;
  held_steps_ = seated ? held_steps_ + 1 : 0;
  return held_steps_ >= hold_steps_;
}

}  // namespace tandem
