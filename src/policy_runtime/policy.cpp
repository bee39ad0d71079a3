#include "policy_runtime/policy.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "policy_runtime/file/config_reader.h"
#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/file/strict_json.h"
#include "policy_runtime/golden.h"
#include "policy_runtime/kernels/kernels.h"
#include "policy_runtime/noise.h"
#include "policy_runtime/scratch.h"

namespace tandem::policy {

std::unique_ptr<const Policy> Policy::load(const std::string& path) {
  kernels();  // a bad TANDEM_KERNEL is refused here, before forward() needs one

  SafetensorsFile file(path);
  Header header = read_header(file);
  const std::string where = path + ": config";
  ConfigReader config(parse_strict_json(file.metadata("config"), where), where);
  const int O = header.observation_size();
  std::unique_ptr<const Head> head =
      load_head(file, header.architecture, std::move(config), {"actor", O, header.action_size()});
  header.horizon = head->horizon();
  auto policy = std::make_unique<Policy>(std::move(header), file.take("normalizer.mean", {O}),
                                         file.take("normalizer.scale", {O}), std::move(head));
  const Golden golden(file, *policy);
  file.refuse_unused();
  policy->golden_error_ = golden.verify(*policy);
  return policy;
}

Policy::Policy(Header header, std::vector<float> mean, std::vector<float> scale,
               std::unique_ptr<const Head> head)
    : header_(std::move(header)),
      mean_(std::move(mean)),
      scale_(std::move(scale)),
      head_(std::move(head)) {}

// observation | noise | chunk | the head's own
Workspace Policy::make_workspace() const {
  return Workspace(padded(header_.observation_size()) + padded(noise_size()) +
                   padded(header_.chunk_size()) + head_->workspace_size(1));
}

bool Policy::forward(const Input& input, float* chunk, Workspace& workspace) const noexcept {
  Scratch scratch(workspace.data());
  const int O = header_.observation_size(), chunk_size = header_.chunk_size();
  float* x = scratch.take(O);  // its padding stays zero: nothing else ever writes there
  float* noise = scratch.take(noise_size());
  float* result = scratch.take(chunk_size);

  const auto is_finite = [](float value) { return std::isfinite(value); };
  for (int i = 0; i < O; ++i) x[i] = (input.observation[i] - mean_[i]) * scale_[i];
  bool usable = std::all_of(x, x + O, is_finite) && (cameras().empty() || input.images);
  if (usable) {
    if (!input.noise) standard_normal(input.seed, noise, noise_size());
    const HeadInput head_input{x, input.images, input.noise ? input.noise : noise};
    head_->forward(head_input, 1, result, scratch.take(0));
    usable = std::all_of(result, result + chunk_size, is_finite);
  }
  if (usable) {
    std::copy_n(result, chunk_size, chunk);
  } else {
    std::fill_n(chunk, chunk_size, 0.0f);
  }
  return usable;
}

}  // namespace tandem::policy
