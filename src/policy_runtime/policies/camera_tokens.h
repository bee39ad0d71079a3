#pragma once

#include <optional>
#include <string>
#include <vector>

#include "policy_runtime/layers/backbone.h"
#include "policy_runtime/layers/dense.h"
#include "policy_runtime/policies/head.h"

namespace tandem::policy {

/// Images as tokens of a transformer: a backbone shared by all cameras, then one token per pixel of
/// its features: W f + b. Camera after camera, each row by row.
class CameraTokens {
 public:
  static constexpr int kMaxCameras = 8;
  static constexpr int kMaxTokens = 4096;  ///< of all cameras together

  struct Config {
    std::vector<Camera> cameras;
    std::optional<ConfigReader> backbone;  ///< none without cameras

    /// Reads cameras ([{"name", "height", "width"}, ...]) and backbone. @throws PolicyError
    static Config read(ConfigReader& reader);
  };

  /// Takes PREFIX.image.*, .backbone.*, .camera_projection.weight (d, C) .bias and, of every
  /// camera, .camera_position.{name} (tokens, d); nothing without cameras. @throws PolicyError
  CameraTokens(SafetensorsFile& file, const std::string& prefix, const Config& config, int d);

  const std::vector<Camera>& cameras() const noexcept { return cameras_; }
  int count() const noexcept { return count_; }                                ///< tokens
  const std::vector<float>& positions() const noexcept { return positions_; }  ///< (count(), d)

  std::size_t workspace_size() const noexcept;

  /// images, one per camera -> X (count(), d). Real-time.
  void forward(const Kernels& kernels, const std::uint8_t* const* images, Rows X,
               float* workspace) const noexcept;

 private:
  std::vector<Camera> cameras_;
  std::vector<Backbone> backbones_;    // one per size of image
  std::vector<std::size_t> backbone_;  // of every camera
  std::optional<Dense> projection_;
  std::vector<float> positions_;
  int count_ = 0;
};

}  // namespace tandem::policy
