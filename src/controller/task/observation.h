#pragma once

#include <string>
#include <vector>

#include "base/section.h"
#include "controller/task/scene.h"

namespace tandem {

struct TaskSpec;

inline constexpr int kMaxObservation = 64;

/// What the policy is told about the world: a list of named numbers, chosen and ordered by the
/// scenario.
///
///   tool_{x,y,z,rx,ry,rz}    tool pose relative to the task's origin, m and rad
///   twist_{...}              velocity of the tool, m/s and rad/s
///   lead_{...}               commanded minus measured pose: how hard the arm is pushing already, m
///   and rad force_{x,y,z}, moment_{x,y,z}   filtered external wrench on the tool, N and N m
///   object_{...}             estimated grasp pose minus tool pose, m and rad
///   object_fine_{...}        the same, clipped to +-fine range and scaled to [-1, 1]
///   goal_{...}               estimated goal pose minus estimated object pose, m and rad
///   goal_fine_{...}          the same, clipped and scaled
///   gripper                  distance between the finger tips, m
///   gripper_commanded        the width that the gripper was told last, m
/// All in base axes. An estimate is the truth plus a bias drawn once per episode and a jitter drawn
/// every step, for the goal and for an object that lies about; the grasp follows from the object's.
/// An object that is fixed to the hand is where a perfect grasp would have it, so the in-hand error
/// stays hidden, as on a real arm.
class Observation {
 public:
  /// Reads `observation` (names) and `observation_noise` of the task section. @throws ScenarioError
  Observation(Section& task, const TaskSpec& spec);

  /// Leaves out goal_* and object_*, for a policy that has to see them.
  void hide_truth();

  int size() const noexcept { return static_cast<int>(terms_.size()); }
  const std::vector<std::string>& names() const noexcept { return names_; }

  /// @param out size() numbers. Allocation-free; depends on nothing but the snapshot.
  void write(const StepSnapshot& snapshot, float* out) const noexcept;

 private:
  std::vector<std::string> names_;
  std::vector<int> terms_;  // index into the table of all terms
  Pose X_W_origin_, X_HO_;
  bool object_is_free_;
  double bias_m_ = 0, bias_rad_ = 0, jitter_m_ = 0, jitter_rad_ = 0, fine_m_ = 0, fine_rad_ = 0;
};

}  // namespace tandem
