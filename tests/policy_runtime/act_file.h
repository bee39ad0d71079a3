#pragma once

#include "policy_runtime/head_formulas.h"
#include "policy_runtime/policies/head.h"
#include "policy_runtime/transformer_formulas.h"
#include "policy_runtime/vision_file.h"

namespace tandem::policy::testing {

struct ActSpec {
  TransformerSpec transformer;
  std::vector<int> tokens = {4, 3};  ///< their sizes
  int latent_size = 5;
  bool sample_latent = false;
  std::string output = "tanh";
  std::vector<Camera> cameras = {};
  std::vector<CnnLayer> backbone = {{4, 3, 2}, {6, 3, 2}};  ///< when there are cameras
};

using Image = std::vector<std::uint8_t>;  ///< (height, width, 3)

class ActFormula : public HeadFormula {
 public:
  ActFormula(Sizes sizes, ActSpec spec) : HeadFormula(std::move(sizes)), spec(std::move(spec)) {}
  const ActSpec spec;

  std::string architecture() const override { return "act"; }
  nlohmann::json config() const override;
  int noise_size() const override { return spec.sample_latent ? spec.latent_size : 0; }
  void add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const override;
  std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                               const std::vector<double>& x, const float* noise) const override;

  /// What the cameras see; black without a word about it, as in the golden examples.
  std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                               const std::vector<double>& x, const float* noise,
                               const std::vector<Image>& images) const;
};

struct FlowTransformerSpec {
  TransformerSpec transformer;
  std::vector<int> tokens = {4, 3};  ///< their sizes
  int steps = 4;
  int time_features = 6;
};

class FlowTransformerFormula : public HeadFormula {
 public:
  FlowTransformerFormula(Sizes sizes, FlowTransformerSpec spec)
      : HeadFormula(std::move(sizes)), spec(std::move(spec)) {}
  const FlowTransformerSpec spec;

  std::string architecture() const override { return "flow"; }
  nlohmann::json config() const override;
  int noise_size() const override { return sizes.chunk(); }
  void add(PolicyFile& file, const std::string& prefix, std::mt19937& random) const override;
  std::vector<double> evaluate(const PolicyFile& file, const std::string& prefix,
                               const std::vector<double>& x, const float* noise) const override;
};

/// Three samples at once, as best of N asks for them, and one after the other: expects the same
/// bits, from a workspace exactly as large as promised and dirty.
void expect_same_samples(const Head& head, int observation_size);

}  // namespace tandem::policy::testing
