#include "policy_runtime/policies/grasp.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

constexpr int kChoices = 2;  // open, closed

float gripper(const float* values) {
  if (!std::isfinite(values[0]) || !std::isfinite(values[1])) {
    return std::numeric_limits<float>::quiet_NaN();
  }
  return values[1] > values[0] ? 1.0f : -1.0f;
}

std::unique_ptr<const Head> load_arm(SafetensorsFile& file, const std::string& architecture,
                                     const ConfigReader& config, HeadSpec spec) {
  --spec.action_size;
  return load_head(file, architecture, config, spec);
}

}  // namespace

GraspHead::Config GraspHead::Config::read(ConfigReader& reader, const HeadSpec& spec) {
  constexpr const char* kOf[] = {"mlp", "gaussian", "flow", "act"};
  ConfigReader head = reader.object("head"), critic = reader.object("critic");
  reader.finish();
  Config config{kOf[head.choice("architecture", {"mlp", "gaussian", "flow", "act"})],
                head.object("config"), Perceptron::Config::read(critic)};
  head.finish();
  critic.finish();
  if (spec.action_size < 2) {
    reader.refuse("decides a gripper, and there is no other axis; an arm needs at least one.");
  }
  return config;
}

GraspHead::GraspHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec)
    : GraspHead(file, Config::read(config, spec), spec) {}

GraspHead::GraspHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec)
    : GraspHead(file, config, spec, load_arm(file, config.architecture, config.head, spec)) {}

GraspHead::GraspHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec,
                     std::unique_ptr<const Head> arm)
    : Head(arm->horizon(), spec.action_size),
      arm_(std::move(arm)),
      critic_(file, "grasp", config.critic, spec.observation_size, kChoices,
              Activation::kIdentity) {}

// values | the arm's chunks | the critic's own | the head's
std::size_t GraspHead::workspace_size(int samples) const noexcept {
  return padded(kChoices) + samples * padded(arm_->chunk_size()) +
         padded(critic_.workspace_size(1)) + arm_->workspace_size(samples);
}

void GraspHead::forward(const HeadInput& input, int samples, float* chunks,
                        float* workspace) const noexcept {
  const int axes = chunk_size() / horizon();
  const std::size_t stride = padded(arm_->chunk_size());
  Scratch scratch(workspace);
  float* values = scratch.take(kChoices);
  float* of_arm = scratch.take(samples * stride);
  critic_.forward(kernels(), {input.x, 0}, 1, {values, 0}, scratch.take(critic_.workspace_size(1)));
  arm_->forward(input, samples, of_arm, scratch.take(0));

  const float chosen = gripper(values);
  for (int i = 0; i < samples; ++i) {
    const float* from = of_arm + i * stride;
    float* to = chunks + i * padded(chunk_size());
    for (int step = 0; step < horizon(); ++step, from += axes - 1) {
      to = std::copy_n(from, axes - 1, to);
      *to++ = chosen;
    }
  }
}

}  // namespace tandem::policy
