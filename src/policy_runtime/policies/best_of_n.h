#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "policy_runtime/policies/critic_ensemble.h"
#include "policy_runtime/policies/edit_network.h"
#include "policy_runtime/policies/head.h"

namespace tandem::policy {

/// Best of N: several heads propose chunks, an edit network may correct each of them, and the one
/// that the critics score highest is the chunk.
///
/// Candidates: the samples of the first head, of the second, ...; then one edited candidate for
/// each of these in the same order. The first of equal scores wins. A candidate that is not finite,
/// or whose score isn't, never wins; when none is left, the chunk is not a number.
/// Noise: (samples, noise_size) of every head in order, then (candidates, h A) of the edits.
///
/// Config: horizon, heads ([{architecture, config, samples}, ...], any head but best_of_n), edit
/// (null or see EditNetwork), critic (see CriticEnsemble). Heads with cameras share them.
class BestOfNHead final : public Head {
 public:
  static constexpr int kMaxHeads = 8;
  static constexpr int kMaxSamples = 256;  ///< of all heads together

  BestOfNHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec);

  int noise_size() const noexcept override { return noise_size_; }
  const std::vector<Camera>& cameras() const noexcept override { return cameras_; }
  std::size_t workspace_size(int samples) const noexcept override;
  void forward(const HeadInput& input, int samples, float* chunks,
               float* workspace) const noexcept override;

 private:
  struct HeadConfig {
    std::string architecture;
    int samples;
    ConfigReader config;
  };
  struct Config {
    int horizon = 1;
    std::vector<HeadConfig> heads;
    std::optional<EditNetwork::Config> edit;
    CriticEnsemble::Config critic;

    static Config read(ConfigReader& reader);
  };
  struct Proposer {
    std::unique_ptr<const Head> head;
    int samples;
  };
  BestOfNHead(SafetensorsFile& file, ConfigReader& reader, const Config& config,
              const HeadSpec& spec);
  void add(std::unique_ptr<const Head> head, int samples, const ConfigReader& reader);
  int n_candidates() const noexcept { return edit_ ? 2 * n_proposed_ : n_proposed_; }
  void forward_one(const HeadInput& input, float* chunk, float* workspace) const noexcept;

  std::vector<Proposer> proposers_;
  std::optional<EditNetwork> edit_;
  CriticEnsemble critic_;
  std::vector<Camera> cameras_;
  int n_proposed_ = 0;  // samples of all heads
  int noise_size_ = 0;
};

}  // namespace tandem::policy
