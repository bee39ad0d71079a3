#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "base/geometry.h"

namespace tandem {

/// What the cameras saw when a step began, their views beside each other in one image. Immutable
/// once made; camera thread -> policy, recorder and link.
struct CameraFrame {
  struct View {
    double focal_length = 0.0;  ///< px
    Pose X_EC;                  ///< C: x right, y down, z where it looks
  };

  int64_t utime = 0;  ///< us
  int64_t episode = 0, tick = 0;
  int32_t step = 0;
  int width = 0, height = 0;    ///< px, of the image
  std::vector<View> views;      ///< from left to right, equally wide
  std::vector<uint8_t> jpeg;    ///< what goes over the wire and into the log
  std::vector<uint8_t> pixels;  ///< (height, width, 3) RGB of that JPEG: what the policy sees
};

/// What of the simulation's state decides how the scene looks. Control thread -> camera thread.
struct SceneState {
  static constexpr int kMaxNumbers = 2048;

  int64_t utime = 0;  ///< us
  int64_t episode = 0, tick = 0;
  int32_t step = 0;
  uint64_t episode_seed = 0;
  std::array<double, kMaxNumbers> numbers;  ///< qpos, body_pos, body_quat, as the model has them
};

}  // namespace tandem
