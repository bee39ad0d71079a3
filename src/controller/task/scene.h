#pragma once

#include "base/geometry.h"

namespace tandem {

/// Demonstration: the human does it all; training: he helps; evaluation: nobody helps. Values as in
/// world_state_t.
enum class Phase : int8_t { demonstration = 0, training = 1, evaluation = 2 };

/// How an episode ended. Values as in episode_end_t.
enum class Outcome : int8_t { success = 0, timeout = 1, fault = 2, discard = 3, failure = 4 };

/// Where the object and its goal really are.
struct SceneTruth {
  Pose X_WO;  ///< object (peg: centre of the tip face); z points into the goal when it fits
  Pose X_WG;  ///< goal (peg: centre of the hole's rim), z out of it
  Pose X_WH;  ///< grasp: where the tool holds the object; fixed to the object
};

/// Everything that is known when a policy step begins. Control thread -> policy, link and recorder.
struct StepSnapshot {
  int64_t utime = 0;  ///< us
  int64_t episode = 0;
  int64_t tick = 0;
  int32_t step = 0;
  Phase phase = Phase::training;
  uint64_t episode_seed = 0;
  double autonomous_success = 0.0;
  Pose X_WE, X_WE_commanded;
  Twist V_WE = Twist::Zero();
  Wrench F_ext_W = Wrench::Zero();  ///< filtered
  double gripper_width = 0.0;       ///< m
  double gripper_commanded = 0.0;   ///< m, the width that the gripper was told last
  SceneTruth truth;
  int32_t chunk_id = -1;  ///< of the inference to make; -1: observe only
};

}  // namespace tandem
