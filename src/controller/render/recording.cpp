#include "controller/render/recording.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <deque>
#include <lcm/lcm-cpp.hpp>
#include <stdexcept>
#include <tandem/episode_end_t.hpp>
#include <tandem/robot_state_t.hpp>
#include <tandem/scenario_t.hpp>
#include <tandem/world_state_t.hpp>

namespace tandem {
namespace {

Pose pose(const double* p, const double* q) {
  return {Eigen::Vector3d::Map(p), Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized()};
}

template <typename Message>
bool decode(const lcm::LogEvent& event, Message& message) {
  return message.decode(event.data, 0, event.datalen) >= 0;
}

void take_scenario(const scenario_t& message, const std::string& path, Recording& recording) {
  try {
    const YAML::Node task = YAML::Load(message.scenario_yaml)["task"];
    recording.scene = task["scene"].as<std::string>();
    if (const YAML::Node clearance = task["clearance_m"])
      recording.clearance = clearance[task["difficulty"].as<std::string>()].as<double>();
  } catch (const YAML::Exception& error) {
    throw std::runtime_error(path + ": the scenario in the log names no task.scene (" +
                             error.what() + ").");
  }
}

}  // namespace

Moment RecordedEpisode::at(double tick) const {
  const auto after =
      std::find_if(moments.begin(), moments.end(), [&](const Moment& m) { return m.tick >= tick; });
  if (after == moments.begin()) return moments.front();
  if (after == moments.end()) return moments.back();
  const Moment &a = *(after - 1), &b = *after;
  const double s = (tick - a.tick) / (b.tick - a.tick);
  Moment m = a;
  m.q += s * (b.q - a.q);
  m.gripper_width += s * (b.gripper_width - a.gripper_width);
  m.alpha += s * (b.alpha - a.alpha);
  m.force += s * (b.force - a.force);
  return m;
}

int RecordedEpisode::step_at(double tick) const {
  const auto after = std::find_if(step_ticks.begin(), step_ticks.end(),
                                  [&](int64_t start) { return start > tick; });
  return std::max(0, static_cast<int>(after - step_ticks.begin()) - 1);
}

Recording read_recording(const std::string& log_path, int episodes) {
  lcm::LogFile log(log_path, "r");
  if (!log.good()) throw std::runtime_error(log_path + ": the event log cannot be opened.");
  Recording recording;
  std::deque<RecordedEpisode> kept;
  RecordedEpisode running;
  while (const lcm::LogEvent* event = log.readNextEvent()) {
    scenario_t scenario{};
    robot_state_t robot{};
    world_state_t world{};
    episode_end_t end{};
    if (event->channel == "SCENARIO" && decode(*event, scenario)) {
      take_scenario(scenario, log_path, recording);
      running = RecordedEpisode();
    } else if (event->channel == "WORLD_STATE" && decode(*event, world)) {
      if (running.step_ticks.empty()) {
        running.X_EO = inverse(pose(world.p_WE, world.q_WE)) * pose(world.p_WO, world.q_WO);
        running.X_WG = pose(world.p_WG, world.q_WG);
        running.max_steps = world.max_steps;
      }
      running.step_ticks.push_back(world.tick);
    } else if (event->channel == "ROBOT_STATE" && decode(*event, robot)) {
      if (!running.moments.empty() && robot.tick <= running.moments.back().tick) continue;
      running.moments.push_back({robot.tick, JointVector::Map(robot.q_measured),
                                 robot.gripper_width, robot.alpha,
                                 Eigen::Vector3d::Map(robot.F_ext_W)});
    } else if (event->channel == "EPISODE_END" && decode(*event, end)) {
      running.number = end.episode;
      running.phase = end.phase;
      running.outcome = end.outcome;
      running.n_steps = end.n_steps;
      if (!running.moments.empty() && !running.step_ticks.empty())
        kept.push_back(std::move(running));
      if (static_cast<int>(kept.size()) > episodes) kept.pop_front();
      running = RecordedEpisode();
    }
  }
  recording.episodes.assign(std::make_move_iterator(kept.begin()),
                            std::make_move_iterator(kept.end()));
  if (recording.scene.empty())
    throw std::runtime_error(
        log_path + ": the log has no SCENARIO event; it was not written by tandem_controller.");
  if (recording.episodes.empty()) {
    throw std::runtime_error(
        log_path +
        ": the log holds no complete episode with ROBOT_STATE and WORLD_STATE; "
        "record one with run.robot_state_hz above 0.");
  }
  return recording;
}

}  // namespace tandem
