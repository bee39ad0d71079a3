#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "base/geometry.h"

namespace tandem {

/// Where the object was when a policy step began.
struct ObjectPose {
  int64_t tick = 0;  ///< ms since the episode began
  Pose X_WO, X_EO;   ///< in the world, in the hand
};

/// The arm at one moment of a recorded episode.
struct Moment {
  int64_t tick = 0;                                 ///< ms since the episode began
  JointVector q = JointVector::Zero();              ///< rad
  double gripper_width = 0.0;                       ///< m
  double alpha = 0.0;                               ///< authority of the human, [0, 1]
  Eigen::Vector3d force = Eigen::Vector3d::Zero();  ///< N, external force on the tool, filtered
};

/// What a picture of one episode needs.
struct RecordedEpisode {
  int64_t number = 0;
  int phase = 0, outcome = 0;  ///< as in episode_end_t
  int n_steps = 0, max_steps = 0;
  uint64_t seed = 0;
  Pose X_WG;                        ///< goal
  std::vector<Moment> moments;      ///< in order of ticks, at least one
  std::vector<ObjectPose> objects;  ///< one a policy step, at least one

  /// Between the two nearest recorded moments; the first and the last one reach beyond their ends.
  Moment at(double tick) const;
  ObjectPose object_at(double tick) const;  ///< the same for the object
  int step_at(double tick) const;           ///< policy step that is running, from 0
};

/// The last `episodes` complete episodes of an LCM event log that the controller wrote.
struct Recording {
  std::string scenario;  ///< YAML
  std::string scene;     ///< path of the MuJoCo scene, relative to the checkout
  std::vector<RecordedEpisode> episodes;
};

/// A cut-off tail is ignored. @throws std::runtime_error with a sentence if there is nothing to
/// draw.
Recording read_recording(const std::string& log_path, int episodes);

}  // namespace tandem
