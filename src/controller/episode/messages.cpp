#include "controller/episode/messages.h"

#include <algorithm>

namespace tandem {
namespace {

template <typename Vector>
void put(const Vector& vector, double* out) {
  for (int i = 0; i < vector.size(); ++i) out[i] = vector[i];
}

void put(const Pose& X, double* p, double* q) {
  put(X.p, p);
  const double sign = X.R.w() < 0.0 ? -1.0 : 1.0;
  q[0] = sign * X.R.w();
  q[1] = sign * X.R.x();
  q[2] = sign * X.R.y();
  q[3] = sign * X.R.z();
}

}  // namespace

robot_state_t to_message(const TickRecord& record, int64_t episode) {
  robot_state_t m;
  m.utime = record.input.utime;
  m.tick = record.tick;
  m.episode = episode;
  put(record.robot.q, m.q_measured);
  put(record.robot.dq, m.dq_measured);
  put(record.robot.tau_measured, m.tau_measured);
  put(record.tau_commanded, m.tau_commanded);
  put(record.X_WE, m.p_WE_measured, m.q_WE_measured);
  put(record.X_WE_reference, m.p_WE_reference, m.q_WE_reference);
  put(record.V_WE, m.V_WE_measured);
  put(record.F_ext_W, m.F_ext_W);
  put(record.force_bound, m.force_bound_W);
  m.gripper_width = record.robot.gripper_width;
  m.alpha = record.alpha;
  m.success_rate = record.robot.success_rate;
  m.limits_acted = static_cast<int32_t>(record.limits_acted);
  std::copy(record.robot.contact_joint.begin(), record.robot.contact_joint.end(), m.contact_joint);
  std::copy(record.robot.contact_W.begin(), record.robot.contact_W.end(), m.contact_W);
  m.robot_mode = static_cast<int32_t>(record.robot.mode);
  m.fault = static_cast<int32_t>(record.robot.fault);
  return m;
}

control_tick_t to_control_tick(const TickRecord& record, int64_t episode) {
  control_tick_t m;
  m.utime = record.input.utime;
  m.tick = record.tick;
  m.episode = episode;
  m.missed_cycles = record.input.missed_cycles;
  m.link_age_ms = record.input.link_age_ms;
  put(record.robot.q, m.q_measured);
  put(record.robot.dq, m.dq_measured);
  put(record.robot.tau_external, m.tau_external);
  put(record.robot.tau_commanded, m.tau_received);
  m.gripper_width = record.robot.gripper_width;
  m.robot_mode = static_cast<int32_t>(record.robot.mode);
  m.fault = static_cast<int32_t>(record.robot.fault);
  put(record.tau_commanded, m.tau_commanded);
  return m;
}

world_state_t to_message(const StepSnapshot& snapshot, const TaskSpec& task) {
  world_state_t m;
  m.utime = snapshot.utime;
  m.tick = snapshot.tick;
  m.episode = snapshot.episode;
  m.step = snapshot.step;
  m.max_steps = task.max_steps;
  m.phase = static_cast<int8_t>(snapshot.phase);
  m.episode_seed = static_cast<int64_t>(snapshot.episode_seed);
  m.autonomous_success = snapshot.autonomous_success;
  put(snapshot.X_WE, m.p_WE, m.q_WE);
  put(snapshot.X_WE_commanded, m.p_WE_commanded, m.q_WE_commanded);
  put(snapshot.truth.X_WO, m.p_WO, m.q_WO);
  put(snapshot.truth.X_WG, m.p_WG, m.q_WG);
  put(snapshot.truth.X_WH, m.p_WH, m.q_WH);
  m.goal_depth = task.goal_depth;
  m.insertion_force = task.insertion_force;
  m.grasp_width = task.grasp_width;
  m.release = task.release ? 1 : 0;
  put(snapshot.F_ext_W, m.F_ext_W);
  put(task.action_limit, m.action_limit);
  m.gripper_width = snapshot.gripper_width;
  return m;
}

action_chunk_t to_message(const ChunkRecord& record, int64_t episode, int64_t utime) {
  action_chunk_t m;
  m.utime = utime;
  m.episode = episode;
  m.observation_tick = record.chunk.observation_tick;
  m.start_tick = record.start_tick;
  m.taken_tick = record.taken_tick;
  m.chunk_id = record.chunk.id;
  m.policy_version = record.chunk.policy_version;
  m.horizon = record.chunk.horizon;
  m.policy_chunk.resize(record.chunk.horizon);
  for (int i = 0; i < record.chunk.horizon; ++i) {
    m.policy_chunk[i].resize(7);
    for (int axis = 0; axis < 7; ++axis)
      m.policy_chunk[i][axis] = static_cast<float>(record.chunk.actions[i][axis]);
  }
  m.wall_inference_us = record.chunk.inference_us;
  return m;
}

teleop_command_t to_message(const HumanCommand& command) {
  teleop_command_t m;
  m.utime = command.utime;
  m.episode_answered = command.episode_answered;
  m.tick_answered = command.tick_answered;
  put(command.twist, m.device_twist);
  m.device_gripper = command.gripper;
  m.engaged = command.engaged ? 1 : 0;
  m.label = command.label;
  m.operator_id = command.operator_id;
  return m;
}

camera_frame_t to_message(const CameraFrame& frame) {
  camera_frame_t m;
  m.utime = frame.utime;
  m.tick = frame.tick;
  m.episode = frame.episode;
  m.step = frame.step;
  m.width = frame.width;
  m.height = frame.height;
  m.n_views = static_cast<int32_t>(frame.views.size());
  const double view_width = static_cast<double>(frame.width) / m.n_views;
  for (const CameraFrame::View& view : frame.views) {
    const double n_before = static_cast<double>(m.focal_length.size());
    m.focal_length.push_back(view.focal_length);
    m.center.push_back({(n_before + 0.5) * view_width, 0.5 * frame.height});
    m.p_EC.emplace_back(3);
    m.q_EC.emplace_back(4);
    put(view.X_EC, m.p_EC.back().data(), m.q_EC.back().data());
  }
  m.n_jpeg = static_cast<int32_t>(frame.jpeg.size());
  m.jpeg = frame.jpeg;
  return m;
}

}  // namespace tandem
