#include "controller/render/recording.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <deque>
#include <stdexcept>
#include <tandem/episode_end_t.hpp>
#include <tandem/robot_state_t.hpp>
#include <tandem/scenario_t.hpp>
#include <tandem/world_state_t.hpp>
#include <tuple>

#include "controller/episode/log_files.h"

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
    recording.scenario = message.scenario_yaml;
  } catch (const YAML::Exception& error) {
    throw std::runtime_error(path + ": the scenario in the log names no task.scene (" +
                             error.what() + ").");
  }
}

/// The two that lie around a tick, and how far it is from the first to the second, [0, 1].
template <typename Stamped>
std::tuple<const Stamped&, const Stamped&, double> around(const std::vector<Stamped>& all,
                                                          double tick) {
  const auto after =
      std::find_if(all.begin(), all.end(), [&](const Stamped& s) { return s.tick >= tick; });
  if (after == all.begin()) return {all.front(), all.front(), 0.0};
  if (after == all.end()) return {all.back(), all.back(), 0.0};
  const Stamped &a = *(after - 1), &b = *after;
  return {a, b, (tick - a.tick) / (b.tick - a.tick)};
}

Pose between(const Pose& a, const Pose& b, double s) { return add(a, s * minus(b, a)); }

}  // namespace

Moment RecordedEpisode::at(double tick) const {
  const auto [a, b, s] = around(moments, tick);
  Moment m = a;
  m.q += s * (b.q - a.q);
  m.gripper_width += s * (b.gripper_width - a.gripper_width);
  m.alpha += s * (b.alpha - a.alpha);
  m.force += s * (b.force - a.force);
  return m;
}

ObjectPose RecordedEpisode::object_at(double tick) const {
  const auto [a, b, s] = around(objects, tick);
  return {a.tick, between(a.X_WO, b.X_WO, s), between(a.X_EO, b.X_EO, s)};
}

int RecordedEpisode::step_at(double tick) const {
  const auto after = std::find_if(objects.begin(), objects.end(),
                                  [&](const ObjectPose& object) { return object.tick > tick; });
  return std::max(0, static_cast<int>(after - objects.begin()) - 1);
}

Recording read_recording(const std::string& log_path, int episodes) {
  EventReader log(log_path);
  Recording recording;
  std::deque<RecordedEpisode> kept;
  RecordedEpisode running;
  while (const lcm::LogEvent* event = log.next()) {
    scenario_t scenario{};
    robot_state_t robot{};
    world_state_t world{};
    episode_end_t end{};
    if (event->channel == "SCENARIO" && decode(*event, scenario)) {
      take_scenario(scenario, log_path, recording);
      running = RecordedEpisode();
    } else if (event->channel == "WORLD_STATE" && decode(*event, world)) {
      if (running.objects.empty()) {
        running.X_WG = pose(world.p_WG, world.q_WG);
        running.max_steps = world.max_steps;
        running.seed = static_cast<uint64_t>(world.episode_seed);
      }
      if (!running.objects.empty() && world.tick <= running.objects.back().tick) continue;
      const Pose X_WE = pose(world.p_WE, world.q_WE), X_WO = pose(world.p_WO, world.q_WO);
      running.objects.push_back({world.tick, X_WO, inverse(X_WE) * X_WO});
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
      if (!running.moments.empty() && !running.objects.empty()) kept.push_back(std::move(running));
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
