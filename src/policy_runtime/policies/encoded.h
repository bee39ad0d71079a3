#pragma once

#include <string>
#include <vector>

#include "policy_runtime/layers/dense.h"
#include "policy_runtime/policies/camera_tokens.h"
#include "policy_runtime/policies/head.h"

namespace tandem::policy {

/// Any other head behind an image encoder: it sees the observation and, behind it, F features.
///
///   f = tanh(norm(W [map(image_1), map(image_2), ...] + b)),  chunk = head([x, f])
///
/// The maps are those of one backbone, flattened row by row, the channels of a pixel side by side.
///
/// Config: cameras, backbone (see CameraTokens), features (F), head ({architecture, config}; any
/// but encoded). Tensors: encoder.image.*, encoder.backbone.*, encoder.projection.*, and the head's
/// own.
class EncodedHead final : public Head {
 public:
  EncodedHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec);

  int noise_size() const noexcept override { return head_->noise_size(); }
  const std::vector<Camera>& cameras() const noexcept override { return cameras_; }
  std::size_t workspace_size(int samples) const noexcept override;
  void forward(const HeadInput& input, int samples, float* chunks,
               float* workspace) const noexcept override;

 private:
  struct Config {
    CameraTokens::Config sight;
    int features = 1;
    std::string architecture;
    ConfigReader head;

    static Config read(ConfigReader& reader);
  };
  EncodedHead(SafetensorsFile& file, ConfigReader& reader, const Config& config,
              const HeadSpec& spec);
  EncodedHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec,
              std::unique_ptr<const Head> head);
  void flatten(const Backbone& backbone, ConstRows map, float* flat) const noexcept;

  int observation_size_;  // O
  int features_;          // F
  std::vector<Camera> cameras_;
  std::vector<Backbone> backbones_;  // of every camera
  int flat_size_;                    // of all maps
  Dense projection_;
  std::unique_ptr<const Head> head_;
};

}  // namespace tandem::policy
