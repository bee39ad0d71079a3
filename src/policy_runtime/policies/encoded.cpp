#include "policy_runtime/policies/encoded.h"

#include <algorithm>
#include <utility>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

const std::string kPrefix = "encoder";

int pixels(const Backbone& backbone) { return backbone.out_height() * backbone.out_width(); }

std::vector<Backbone> load_backbones(SafetensorsFile& file, const CameraTokens::Config& sight) {
  std::vector<Backbone> backbones;
  for (const Camera& camera : sight.cameras) {
    backbones.push_back(load_backbone(file, kPrefix, *sight.backbone, camera.height, camera.width));
  }
  return backbones;
}

int flat_size(const std::vector<Backbone>& backbones) {
  int size = 0;
  for (const Backbone& backbone : backbones) size += pixels(backbone) * backbone.channels();
  return size;
}

std::unique_ptr<const Head> load_inner(SafetensorsFile& file, const std::string& architecture,
                                       const ConfigReader& config, HeadSpec spec, int features) {
  spec.observation_size += features;
  return load_head(file, architecture, config, spec);
}

}  // namespace

EncodedHead::Config EncodedHead::Config::read(ConfigReader& reader) {
  constexpr int kMaxFeatures = 4096;
  CameraTokens::Config sight = CameraTokens::Config::read(reader);
  if (sight.cameras.empty()) reader.refuse("has no cameras; it must have at least one.");
  const int features = reader.integer("features", 1, kMaxFeatures);
  ConfigReader head = reader.object("head");
  reader.finish();
  Config config{std::move(sight), features, head.name("architecture"), head.object("config")};
  head.finish();
  if (config.architecture == "encoded") {
    reader.refuse("has a head that is encoded again; it must be any other architecture.");
  }
  return config;
}

EncodedHead::EncodedHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec)
    : EncodedHead(file, config, Config::read(config), spec) {}

EncodedHead::EncodedHead(SafetensorsFile& file, ConfigReader& reader, const Config& config,
                         const HeadSpec& spec)
    : EncodedHead(file, config, spec,
                  load_inner(file, config.architecture, config.head, spec, config.features)) {
  if (!head_->cameras().empty() && head_->cameras() != cameras_) {
    reader.refuse("has a head with other cameras than its own; they must be the same.");
  }
}

EncodedHead::EncodedHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec,
                         std::unique_ptr<const Head> head)
    : Head(head->horizon(), spec.action_size),
      observation_size_(spec.observation_size),
      features_(config.features),
      cameras_(config.sight.cameras),
      backbones_(load_backbones(file, config.sight)),
      flat_size_(flat_size(backbones_)),
      projection_(file, kPrefix + ".projection", flat_size_, features_, true, Activation::kTanh),
      head_(std::move(head)) {}

// observation and features | the head's own | features | flat maps | a map | the backbone's own
std::size_t EncodedHead::workspace_size(int samples) const noexcept {
  std::size_t map = 0, own = 0;
  for (const Backbone& backbone : backbones_) {
    map = std::max(map, pixels(backbone) * padded(backbone.channels()));
    own = std::max(own, backbone.workspace_size());
  }
  return padded(observation_size_ + features_) + padded(head_->workspace_size(samples)) +
         padded(features_) + padded(flat_size_) + map + own;
}

void EncodedHead::forward(const HeadInput& input, int samples, float* chunks,
                          float* workspace) const noexcept {
  const Kernels& kernels = policy::kernels();
  Scratch scratch(workspace);
  float* x = scratch.take(observation_size_ + features_);
  float* of_head = scratch.take(head_->workspace_size(samples));
  float* f = scratch.take(features_);
  float* flat = scratch.take(flat_size_);

  float* next = flat;
  for (std::size_t i = 0; i < backbones_.size(); ++i) {
    const Backbone& backbone = backbones_[i];
    Scratch rest = scratch;
    const std::size_t stride = padded(backbone.channels());
    const Rows map{rest.take(pixels(backbone) * stride), stride};
    backbone.forward(kernels, input.images[i], map, rest.take(0));
    flatten(backbone, map, next);
    next += pixels(backbone) * backbone.channels();
  }
  projection_.forward(kernels, flat, f);

  std::copy_n(input.x, observation_size_, x);
  std::copy_n(f, features_, x + observation_size_);
  HeadInput seen = input;
  seen.x = x;
  head_->forward(seen, samples, chunks, of_head);
}

// Without the padding of the pixels.
void EncodedHead::flatten(const Backbone& backbone, ConstRows map, float* flat) const noexcept {
  for (int i = 0; i < pixels(backbone); ++i)
    flat = std::copy_n(map.data + i * map.stride, backbone.channels(), flat);
}

}  // namespace tandem::policy
