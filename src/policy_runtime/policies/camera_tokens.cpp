#include "policy_runtime/policies/camera_tokens.h"

#include <algorithm>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/policy_error.h"
#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

bool same_size(const Camera& a, const Camera& b) {
  return a.height == b.height && a.width == b.width;
}

int pixels(const Backbone& backbone) { return backbone.out_height() * backbone.out_width(); }

}  // namespace

CameraTokens::Config CameraTokens::Config::read(ConfigReader& reader) {
  Config config;
  for (ConfigReader& camera : reader.objects("cameras", 0, kMaxCameras)) {
    config.cameras.push_back({camera.name("name"),
                              camera.integer("height", Backbone::kMinSide, Backbone::kMaxSide),
                              camera.integer("width", Backbone::kMinSide, Backbone::kMaxSide)});
    camera.finish();
    const std::string& name = config.cameras.back().name;
    const auto has_name = [&](const Camera& other) { return other.name == name; };
    if (std::count_if(config.cameras.begin(), config.cameras.end(), has_name) > 1) {
      reader.refuse("has two cameras named " + printable(name) + "; names must differ.");
    }
  }
  if (reader.is_null("backbone") != config.cameras.empty()) {
    reader.refuse("needs a backbone when there are cameras, and null when there are none.");
  }
  if (!config.cameras.empty()) config.backbone = reader.object("backbone");
  return config;
}

CameraTokens::CameraTokens(SafetensorsFile& file, const std::string& prefix, const Config& config,
                           int d)
    : cameras_(config.cameras) {
  for (const Camera& camera : cameras_) {
    const std::size_t before =
        std::find_if(cameras_.begin(), cameras_.end(),
                     [&](const Camera& other) { return same_size(camera, other); }) -
        cameras_.begin();
    if (before < backbone_.size()) {
      backbone_.push_back(backbone_[before]);
    } else {
      backbone_.push_back(backbones_.size());
      backbones_.push_back(
          load_backbone(file, prefix, *config.backbone, camera.height, camera.width));
    }
    count_ += pixels(backbones_[backbone_.back()]);
  }
  if (count_ > kMaxTokens) {
    throw PolicyError(file.path() + ": the cameras give " + std::to_string(count_) +
                      " tokens; the limit is " + std::to_string(kMaxTokens) +
                      ". Use smaller images or a backbone with larger strides.");
  }
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    const std::vector<float> positions = file.take(prefix + ".camera_position." + cameras_[i].name,
                                                   {pixels(backbones_[backbone_[i]]), d});
    positions_.insert(positions_.end(), positions.begin(), positions.end());
  }
  if (!cameras_.empty()) {
    projection_.emplace(file, prefix + ".camera_projection", backbones_.front().channels(), d,
                        false, Activation::kIdentity);
  }
}

// features of one camera | the backbone's own
std::size_t CameraTokens::workspace_size() const noexcept {
  std::size_t features = 0, own = 0;
  for (const Backbone& backbone : backbones_) {
    features = std::max(features, pixels(backbone) * padded(backbone.channels()));
    own = std::max(own, backbone.workspace_size());
  }
  return features + own;
}

void CameraTokens::forward(const Kernels& kernels, const std::uint8_t* const* images, Rows X,
                           float* workspace) const noexcept {
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    const Backbone& backbone = backbones_[backbone_[i]];
    const int n = pixels(backbone);
    Scratch scratch(workspace);
    const std::size_t stride = padded(backbone.channels());
    const Rows features{scratch.take(n * stride), stride};
    backbone.forward(kernels, images[i], features, scratch.take(0));
    projection_->forward(kernels, features, n, X);
    X.data += n * X.stride;
  }
}

}  // namespace tandem::policy
