#pragma once

#include <memory>
#include <string>

#include "policy_runtime/layers/perceptron.h"
#include "policy_runtime/policies/head.h"

namespace tandem::policy {

/// Another head moves the arm, and a critic of its own decides the gripper, which is the last axis:
/// it values an open and a closed hand, and the chunk has -1 (open) or 1 (closed) throughout,
/// whichever is worth more; open when they are equal. A value that is not a number makes it one.
///
/// Config: head ({architecture, config}; mlp, gaussian, flow or act), critic (hidden, activation,
/// layer_norm).
class GraspHead final : public Head {
 public:
  /// Takes the head's tensors, and grasp.layers.{i}.*. @throws PolicyError
  GraspHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec);

  int noise_size() const noexcept override { return arm_->noise_size(); }
  const std::vector<Camera>& cameras() const noexcept override { return arm_->cameras(); }
  std::size_t workspace_size(int samples) const noexcept override;
  void forward(const HeadInput& input, int samples, float* chunks,
               float* workspace) const noexcept override;

 private:
  struct Config {
    std::string architecture;
    ConfigReader head;
    Perceptron::Config critic;

    static Config read(ConfigReader& reader, const HeadSpec& spec);
  };
  GraspHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec);
  GraspHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec,
            std::unique_ptr<const Head> arm);

  std::unique_ptr<const Head> arm_;  // the axes before the gripper
  Perceptron critic_;                // x -> what an open hand is worth, and a closed one
};

}  // namespace tandem::policy
