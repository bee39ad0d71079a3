#include "tracking_run.h"

#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "controller/chunk/chunk_executor.h"
#include "controller/robot/mujoco_robot.h"

namespace tandem::bench {
namespace {

ExecutionSettings execution() {
  ExecutionSettings settings;
  settings.mode = ExecutionMode::open_loop;
  settings.horizon = kHorizon;
  settings.execute = kExecute;
  return settings;
}

Chunk chunk_at(const std::vector<Action>& actions, int id, int step) {
  Chunk chunk;
  chunk.id = id;
  chunk.policy_version = 1;
  chunk.observation_tick = static_cast<int64_t>(step) * kTicksPerStep;
  chunk.start_step = step;
  chunk.horizon = kHorizon;
  chunk.actions.fill(Action::Zero());
  for (int i = 0; i < kHorizon && step + i < kSteps; ++i) chunk.actions[i] = actions[step + i];
  return chunk;
}

/// The reference orientation whose log-map error is the vector part of the true error's quaternion.
Eigen::Quaterniond half_way(const Eigen::Quaterniond& R_reference, const Eigen::Quaterniond& R) {
  Eigen::Quaterniond error = R_reference * R.conjugate();
  if (error.w() < 0) error.coeffs() *= -1.0;
  return exp_map(error.vec()) * R;
}

}  // namespace

TrackingSettings read_tracking(Section controller) {
  return {read_gains(controller.section("law")), read_safety(controller.section("safety")),
          read_reference(controller.section("reference")), read_robot(controller.section("robot"))};
}

Tracking follow_path(Variant variant, const TrackingSettings& settings, double load,
                     const std::string& models) {
  Simulation simulation(models + "/arm/scene.xml");
  MujocoRobot robot(simulation, settings.robot);
  ArmModel model(models + "/panda/panda.urdf");
  model.set_load(simulation.held_load());
  JointVector home;
  home << 0, -0.785398, 0, -2.356194, 0, 1.570796, 0.785398;
  robot.place(model.solve_ik(path_start(), home), 0.02);
  Wrench unknown;
  unknown << 0.0, 0.0, -load, 0.0, kLever * load, 0.0;
  simulation.push(unknown);

  CartesianImpedance law(settings.gains);
  SafetyFilter safety(settings.safety, model, {0.2, -0.4, 0.05}, {0.8, 0.4, 0.6});
  ReferenceFilter reference(settings.reference);
  ChunkExecutor executor(execution(), Action::Ones(), kTicksPerStep);
  executor.begin_episode(0, false);
  const std::vector<Action> actions = path_actions();
  const double lag = 2.0 / settings.reference.omega;

  ArmState arm;
  model.update(robot.state().q, robot.state().dq, arm);
  Pose commanded = arm.X_WE;
  reference.reset(commanded);
  Tracking result;
  int path_ticks = 0;
  for (int tick = 0; tick < kSteps * kTicksPerStep; ++tick) {
    const int step = tick / kTicksPerStep;
    model.update(robot.state().q, robot.state().dq, arm);
    if (tick % kTicksPerStep == 0) {
      if (executor.needs_chunk(step)) executor.accept(chunk_at(actions, step, step), tick);
      if (variant == Variant::measured_anchor) commanded = arm.X_WE;
    }

    // As in the control loop: increments, cut so that no axis leads by more than the error clip.
    const Twist increment =
        executor.action(step, 1.0).head<6>().cwiseProduct(action_limit()) / kTicksPerStep;
    commanded = add(commanded, law.allowed(increment, minus(commanded, arm.X_WE), arm.X_WE.R));
    PoseReference tracked = reference.step(commanded);
    if (variant == Variant::half_rotation) tracked.X_WE.R = half_way(tracked.X_WE.R, arm.X_WE.R);
    robot.write(safety.limit(arm, law.torque(arm, tracked), robot.state().tau_commanded));
    if (robot.state().fault != Fault::none) {
      throw std::runtime_error(std::string("the robot stopped on the path because ") +
                               fault_text(robot.state().fault) + ".");
    }

    const double seconds = tick * 0.001;
    const Twist error = minus(path(seconds), arm.X_WE);
    const double position = error.head<3>().norm(), rotation = error.tail<3>().norm();
    if (seconds < kPathSeconds) {
      const Twist delayed = minus(path(seconds - lag), arm.X_WE);
      result.position_rms += position * position;
      result.rotation_rms += rotation * rotation;
      result.delayed_position_rms += delayed.head<3>().squaredNorm();
      result.delayed_rotation_rms += delayed.tail<3>().squaredNorm();
      result.position_max = std::max(result.position_max, position);
      result.rotation_max = std::max(result.rotation_max, rotation);
      ++path_ticks;
    }
    result.position_steady = position;
    result.rotation_steady = rotation;
  }
  for (double* sum : {&result.position_rms, &result.rotation_rms, &result.delayed_position_rms,
                      &result.delayed_rotation_rms}) {
    *sum = std::sqrt(*sum / path_ticks);
  }
  return result;
}

}  // namespace tandem::bench
