#include "policy_runtime/policies/flow.h"

#include <algorithm>
#include <utility>

#include "policy_runtime/policies/perceptron_field.h"
#include "policy_runtime/policies/transformer_field.h"
#include "policy_runtime/scratch.h"

namespace tandem::policy {

FlowHead::Config FlowHead::Config::read(ConfigReader& reader) {
  constexpr int kMaxSteps = 100, kMaxTimeFeatures = 256;
  const Config config{reader.choice("field", {"mlp", "transformer"}) == 1,
                      reader.integer("horizon", 1, kMaxHorizon),
                      reader.integer("steps", 1, kMaxSteps),
                      reader.integer("time_features", 2, kMaxTimeFeatures)};
  if (config.time_features % 2 != 0) {
    reader.refuse("has " + std::to_string(config.time_features) +
                  " time_features; it must be an even number.");
  }
  reader.choice("output", {"clip"});
  return config;
}

FlowHead::FlowHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec)
    : FlowHead(file, config, Config::read(config), spec) {}

FlowHead::FlowHead(SafetensorsFile& file, ConfigReader& reader, const Config& config,
                   const HeadSpec& spec)
    : Head(config.horizon, spec.action_size),
      steps_(config.steps),
      field_(load_field(file, reader, config, spec)) {}

std::unique_ptr<const VelocityField> FlowHead::load_field(SafetensorsFile& file,
                                                          ConfigReader& reader,
                                                          const Config& config,
                                                          const HeadSpec& spec) {
  std::vector<std::vector<double>> phi;
  for (int k = 0; k < config.steps; ++k) {
    phi.push_back(time_features(config.time_features, double(k) / config.steps));
  }
  if (config.transformer) {
    const auto field = TransformerField::Config::read(reader, spec.observation_size);
    reader.finish();
    return std::make_unique<TransformerField>(file, spec.prefix, field, config.horizon,
                                              spec.action_size, phi);
  }
  const Perceptron::Config perceptron = Perceptron::Config::read(reader);
  reader.finish();
  return std::make_unique<PerceptronField>(file, spec.prefix, perceptron, spec.observation_size,
                                           config.horizon * spec.action_size, std::move(phi));
}

// velocity | the field's own
std::size_t FlowHead::workspace_size(int samples) const noexcept {
  return samples * padded(chunk_size()) + field_->workspace_size(samples);
}

// The padding of the chunks is left alone: once not a number, it would stay so for ever.
void FlowHead::forward(const HeadInput& input, int samples, float* chunks,
                       float* workspace) const noexcept {
  const int n = chunk_size();
  const std::size_t stride = padded(n);
  Scratch scratch(workspace);
  float* velocity = scratch.take(samples * stride);
  float* of_field = scratch.take(0);

  for (int row = 0; row < samples; ++row) {
    std::copy_n(input.noise + std::size_t(row) * n, n, chunks + row * stride);
  }
  field_->observe(input.x, of_field);
  const float dt = 1.0f / float(steps_);
  for (int k = 0; k < steps_; ++k) {
    field_->velocity(k, {chunks, stride}, samples, {velocity, stride}, of_field);
    for (int row = 0; row < samples; ++row) {
      float* a = chunks + row * stride;
      const float* v = velocity + row * stride;
      for (int i = 0; i < n; ++i) a[i] += v[i] * dt;
    }
  }
  for (int row = 0; row < samples; ++row) {
    for (float* a = chunks + row * stride; a < chunks + row * stride + n; ++a) {
      *a = std::clamp(*a, -1.0f, 1.0f);
    }
  }
}

}  // namespace tandem::policy
