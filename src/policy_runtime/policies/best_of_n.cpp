#include "policy_runtime/policies/best_of_n.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "policy_runtime/scratch.h"

namespace tandem::policy {

BestOfNHead::Config BestOfNHead::Config::read(ConfigReader& reader) {
  Config config;
  config.horizon = reader.integer("horizon", 1, kMaxHorizon);
  int samples = 0;
  for (ConfigReader& each : reader.objects("heads", 1, kMaxHeads)) {
    config.heads.push_back({each.name("architecture"), each.integer("samples", 1, kMaxSamples),
                            each.object("config")});
    each.finish();
    if (config.heads.back().architecture == "best_of_n") {
      each.refuse("is a best_of_n again; it must be any other architecture.");
    }
    if (config.heads.back().architecture == "encoded") {
      each.refuse("is encoded; the encoder goes around the best_of_n, so that all see one image.");
    }
    if (config.heads.back().architecture == "grasp") {
      each.refuse("is a grasp; here the critics choose all axes, the gripper among them.");
    }
    samples += config.heads.back().samples;
  }
  if (samples > kMaxSamples) {
    reader.refuse("has heads with " + std::to_string(samples) + " samples together; " +
                  std::to_string(kMaxSamples) + " are the limit.");
  }
  if (!reader.is_null("edit")) config.edit = EditNetwork::Config::read(reader.object("edit"));
  config.critic = CriticEnsemble::Config::read(reader.object("critic"));
  reader.finish();
  return config;
}

BestOfNHead::BestOfNHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec)
    : BestOfNHead(file, config, Config::read(config), spec) {}

BestOfNHead::BestOfNHead(SafetensorsFile& file, ConfigReader& reader, const Config& config,
                         const HeadSpec& spec)
    : Head(config.horizon, spec.action_size),
      critic_(file, config.critic, spec.observation_size, chunk_size()) {
  for (const HeadConfig& each : config.heads) {
    HeadSpec head_spec = spec;
    head_spec.prefix += "." + std::to_string(proposers_.size());
    add(load_head(file, each.architecture, each.config, head_spec), each.samples, reader);
  }
  if (config.edit) {
    edit_.emplace(file, *config.edit, spec.observation_size, chunk_size());
    noise_size_ += n_proposed_ * chunk_size();
  }
}

void BestOfNHead::add(std::unique_ptr<const Head> head, int samples, const ConfigReader& reader) {
  if (head->horizon() != horizon()) {
    reader.refuse("has a head with the horizon " + std::to_string(head->horizon()) +
                  "; it must be that of the whole, " + std::to_string(horizon()) + ".");
  }
  if (!head->cameras().empty()) {
    if (!cameras_.empty() && head->cameras() != cameras_) {
      reader.refuse("has heads with different cameras; heads with cameras must have the same.");
    }
    cameras_ = head->cameras();
  }
  n_proposed_ += samples;
  noise_size_ += samples * head->noise_size();
  proposers_.push_back({std::move(head), samples});
}

// candidates | scores | each head's own | the edit network's | the critics'
std::size_t BestOfNHead::workspace_size(int) const noexcept {
  std::size_t size = n_candidates() * padded(chunk_size()) + padded(n_candidates());
  for (const Proposer& each : proposers_) size += padded(each.head->workspace_size(each.samples));
  if (edit_) size += padded(edit_->workspace_size(n_proposed_));
  return size + critic_.workspace_size(n_candidates());
}

void BestOfNHead::forward(const HeadInput& input, int samples, float* chunks,
                          float* workspace) const noexcept {
  for (int i = 0; i < samples; ++i) {
    HeadInput one = input;
    if (one.noise) one.noise += std::size_t(i) * noise_size();
    forward_one(one, chunks + i * padded(chunk_size()), workspace);
  }
}

void BestOfNHead::forward_one(const HeadInput& input, float* chunk,
                              float* workspace) const noexcept {
  const std::size_t stride = padded(chunk_size());
  Scratch scratch(workspace);
  float* candidates = scratch.take(n_candidates() * stride);
  float* scores = scratch.take(n_candidates());

  HeadInput rest = input;  // its noise moves on
  float* next = candidates;
  for (const Proposer& each : proposers_) {
    each.head->forward(rest, each.samples, next,
                       scratch.take(each.head->workspace_size(each.samples)));
    rest.noise += std::size_t(each.samples) * each.head->noise_size();
    next += each.samples * stride;
  }
  if (edit_) {
    edit_->forward(input.x, rest.noise, candidates, n_proposed_, next,
                   scratch.take(edit_->workspace_size(n_proposed_)));
  }
  critic_.forward(input.x, candidates, n_candidates(), scores, scratch.take(0));

  const auto is_finite = [](float value) { return std::isfinite(value); };
  const float* winner = nullptr;
  float highest = -std::numeric_limits<float>::infinity();
  for (int i = 0; i < n_candidates(); ++i) {
    const float* candidate = candidates + i * stride;
    if (std::isfinite(scores[i]) && scores[i] > highest &&
        std::all_of(candidate, candidate + chunk_size(), is_finite)) {
      winner = candidate;
      highest = scores[i];
    }
  }
  if (winner) {
    std::copy_n(winner, chunk_size(), chunk);
  } else {
    std::fill_n(chunk, chunk_size(), std::numeric_limits<float>::quiet_NaN());
  }
}

}  // namespace tandem::policy
