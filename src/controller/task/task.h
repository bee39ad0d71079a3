#pragma once

#include <memory>
#include <string>

#include "base/section.h"
#include "controller/chunk/chunk.h"
#include "controller/law/arm_model.h"
#include "controller/robot/mujoco_robot.h"
#include "controller/task/observation.h"
#include "controller/task/scene.h"

namespace tandem {

/// What every task says about itself; the common keys of the `task` section.
struct TaskSpec {
  std::string name;
  std::string scene;                     ///< MJCF file, relative to the root of the checkout
  int ticks_per_step = 100;              ///< control ticks in a policy step
  int max_steps = 0;                     ///< policy steps until time-out
  std::vector<std::string> action_axes;  ///< active ones of x y z rx ry rz gripper
  Action axes = Action::Zero();          ///< 1 = active, 0 = masked
  Twist action_limit =
      Twist::Zero();  ///< m, rad per policy step at |action| = 1; 0 for masked axes
  Eigen::Vector3d workspace_low,
      workspace_high;            ///< m, box that the commanded tool position stays in
  Pose X_W_origin;               ///< where the tool starts when nothing is random
  Pose X_HO;                     ///< the object in the grasp's frame, as designed
  double goal_depth = 0.0;       ///< m, how far the object goes into the goal
  double insertion_force = 0.0;  ///< N, what the goal resists with until the object is home
  double grasp_width = 0.0;      ///< m between the finger tips that hold it; 0 = fixed to the hand
  bool release = false;          ///< success asks for an empty hand
  double gripper_start = 1.0;    ///< gripper action that an episode begins with: -1 open, 1 closed
};

/// A task: scene, reset distribution, success test. Adding one touches models/ and one file here.
class Task {
 public:
  virtual ~Task() = default;

  const TaskSpec& spec() const noexcept { return spec_; }
  const Observation& observation() const noexcept { return *observation_; }

  /// Takes from the observation what only a camera could tell; see Observation. Before anything
  /// else.
  void hide_truth() { observation_->hide_truth(); }

  /// Looks the scene's parts up and shapes them. Call once, before anything else. @throws
  /// std::runtime_error
  virtual void attach(Simulation& simulation) = 0;

  /// Puts what an episode finds beside arm and object, such as fixtures and lights, by its seed
  /// alone: whoever draws a recorded episode does it again. Part of reset(). Not real-time.
  virtual void stage(Simulation&, uint64_t /*episode_seed*/) const {}

  /// Draws an episode from its seed and puts arm and scene there. Not real-time. @throws
  /// std::runtime_error
  virtual void reset(MujocoRobot& robot, ArmModel& arm, uint64_t episode_seed) = 0;

  /// Where the object and the goal are now. Real-time.
  virtual SceneTruth truth(const Simulation& simulation) const noexcept = 0;

  /// Whether the scene shows success; asked once at the end of each policy step, so that a task may
  /// ask for it to last. Real-time.
  virtual bool succeeded(const SceneTruth& truth, const Simulation& simulation) noexcept = 0;

 protected:
  explicit Task(Section& section);

  TaskSpec spec_;
  std::unique_ptr<Observation> observation_;
};

/// Makes the task that `section.name` names. Reads the whole section. @throws ScenarioError
std::unique_ptr<Task> make_task(Section section);

}  // namespace tandem
