#pragma once

#include <string>
#include <vector>

#include "base/section.h"

namespace tandem {

/// The `camera` section of the controller: the cameras that an image observation is made of.
struct CameraSettings {
  /// How an episode's light, colours and camera mount differ from the model: half-widths of uniform
  /// distributions, one draw an episode.
  struct Jitter {
    double light = 0.0;       ///< share of each light's brightness
    double colour = 0.0;      ///< share of each colour channel, of lights and surfaces
    double position_m = 0.0;  ///< per axis
    double angle_rad = 0.0;   ///< per axis
  };

  std::string name;                ///< of the image, for channel and policy
  std::vector<std::string> views;  ///< cameras of the scene, from left to right in the image
  int width = 0, height = 0;       ///< px, of a view
  double crop = 1.0;               ///< of each camera's view, a side, about its centre
  int jpeg_quality = 0;
  Jitter jitter;

  int image_width() const { return width * static_cast<int>(views.size()); }

  /// CAMERA_<NAME>, where its frames are published.
  std::string channel() const;
};

/// @throws ScenarioError
CameraSettings read_camera(Section section);

}  // namespace tandem
