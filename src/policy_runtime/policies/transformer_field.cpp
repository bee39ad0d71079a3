#include "policy_runtime/policies/transformer_field.h"

#include <algorithm>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/layers/add.h"
#include "policy_runtime/scratch.h"

namespace tandem::policy {

TransformerField::Config TransformerField::Config::read(ConfigReader& reader,
                                                        int observation_size) {
  return {TransformerConfig::read(reader), reader.integer("encoder_layers", 0, kMaxLayers),
          reader.integer("decoder_layers", 1, kMaxLayers),
          ObservationTokens::read(reader, observation_size)};
}

TransformerField::TransformerField(SafetensorsFile& file, const std::string& prefix,
                                   const Config& config, int horizon, int action_size,
                                   const std::vector<std::vector<double>>& phi)
    : horizon_(horizon),
      action_size_(action_size),
      d_(config.transformer.model_size),
      tokens_(config.tokens),
      query_positions_(file.take(prefix + ".query_position", {horizon, d_}), horizon, d_),
      positions_(file.take(prefix + ".token_position", {tokens_.count(), d_}), tokens_.count(), d_),
      encoder_(file, prefix + ".encoder", config.transformer, config.encoder_layers,
               tokens_.of_encoder(prefix), positions_),
      layers_(load_decoder(file, prefix, config, query_positions_, positions_)),
      action_(
          load_action(file, prefix, query_positions_, action_size, layers_.front().projection())),
      time_(load_time(file, prefix, d_, phi, layers_.front().projection())),
      norm_(take_layer_norm(file, prefix + ".norm", d_)),
      output_(file, prefix + ".output", d_, action_size, false, Activation::kIdentity) {}

std::vector<DecoderLayer> TransformerField::load_decoder(SafetensorsFile& file,
                                                         const std::string& prefix,
                                                         const Config& config,
                                                         const PositionRows& positions,
                                                         const PositionRows& memory_positions) {
  std::vector<DecoderLayer> layers;
  for (int i = 0; i < config.decoder_layers; ++i) {
    layers.emplace_back(file, prefix + ".decoder." + std::to_string(i), config.transformer,
                        positions, memory_positions);
  }
  return layers;
}

Embedding TransformerField::load_action(SafetensorsFile& file, const std::string& prefix,
                                        const PositionRows& positions, int action_size,
                                        const Projection& projection) {
  const int d = positions.d(), h = positions.count();
  const std::vector<float> W = file.take(prefix + ".action.weight", {d, action_size});
  const std::vector<float> b = file.take(prefix + ".action.bias", {d});
  const ConstRows P = positions;
  AlignedBuffer offsets(h * padded(d));
  for (int j = 0; j < h; ++j) {
    for (int c = 0; c < d; ++c) {
      offsets.data()[j * padded(d) + c] = b[c] + P.data[j * P.stride + c];
    }
  }
  return {W, d, action_size, {offsets.data(), padded(d)}, h, &projection, 0};
}

AlignedBuffer TransformerField::load_time(SafetensorsFile& file, const std::string& prefix, int d,
                                          const std::vector<std::vector<double>>& phi,
                                          const Projection& projection) {
  const int steps = static_cast<int>(phi.size()), F = static_cast<int>(phi.front().size());
  const std::vector<float> W = file.take(prefix + ".time.weight", {d, F});
  AlignedBuffer times(steps * padded(d));
  for (int k = 0; k < steps; ++k) {
    for (int row = 0; row < d; ++row) {
      double sum = 0.0;
      for (int i = 0; i < F; ++i) sum += W[std::size_t(row) * F + i] * phi[k][i];
      times.data()[k * padded(d) + row] = static_cast<float>(sum);
    }
  }
  return Embedding::rows({times.data(), padded(d)}, steps, d, &projection);
}

// the memory's keys and values | the larger of
//   observe: the encoder's first rows | memory | what embedding or encoder need
//   velocity: actions | the decoder's first rows | its result | projection of all layers but the
//             first | velocities | a layer's own
std::size_t TransformerField::workspace_size(int samples) const noexcept {
  const std::size_t observing = encoder_.tokens() * (encoder_.row_stride() + padded(d_)) +
                                std::max(tokens_.workspace_size(), encoder_.workspace_size());
  const std::size_t moving =
      samples * horizon_ * (2 * padded(action_size_) + row_stride() + padded(d_) + padded(3 * d_)) +
      layers_.front().workspace_size(samples);
  return memory_size() + std::max(observing, moving);
}

void TransformerField::observe(const float* x, float* workspace) const noexcept {
  const Kernels& kernels = policy::kernels();
  const int tokens = encoder_.tokens();
  Scratch scratch(workspace + memory_size());
  const Rows rows{scratch.take(tokens * encoder_.row_stride()), encoder_.row_stride()};
  const Rows memory{scratch.take(tokens * padded(d_)), padded(d_)};
  float* rest = scratch.take(0);

  tokens_.embed(kernels, encoder_, 0, x, rows, rest);
  encoder_.forward(kernels, rows, memory, rest);
  for (std::size_t i = 0; i < layers_.size(); ++i) {
    layers_[i].memory_projection().forward(kernels, memory, tokens, memory_of(i, workspace));
  }
}

void TransformerField::velocity(int step, ConstRows A, int samples, Rows V,
                                float* workspace) const noexcept {
  const Kernels& kernels = policy::kernels();
  const int n = samples * horizon_;
  const std::size_t narrow = padded(action_size_);
  Scratch scratch(workspace + memory_size());
  const Rows actions{scratch.take(n * narrow), narrow};
  const Rows rows{scratch.take(n * row_stride()), row_stride()};
  const Rows Y{scratch.take(n * padded(d_)), padded(d_)};
  const Rows QKV{scratch.take(n * padded(3 * d_)), padded(3 * d_)};
  const Rows velocities{scratch.take(n * narrow), narrow};
  float* rest = scratch.take(0);

  for (int i = 0; i < n; ++i) {
    const float* a = A.data + i / horizon_ * A.stride + i % horizon_ * action_size_;
    float* row = actions.data + i * narrow;
    std::fill(std::copy_n(a, action_size_, row), row + narrow, 0.0f);
  }
  action_.forward(kernels, actions, samples, rows);
  const float* time = time_.data() + step * row_stride();
  for (int i = 0; i < n; ++i) {
    add(time, static_cast<int>(rows.stride), rows.data + i * rows.stride);
  }

  layers_.front().forward(kernels, rows, {rows.data + padded(d_), rows.stride},
                          memory_of(0, workspace), samples, Y, rest);
  for (std::size_t l = 1; l < layers_.size(); ++l) {
    for (int i = 0; i < n; i += horizon_) {
      layers_[l].projection().forward(kernels, {Y.data + i * Y.stride, Y.stride}, horizon_,
                                      {QKV.data + i * QKV.stride, QKV.stride});
    }
    layers_[l].forward(kernels, Y, QKV, memory_of(l, workspace), samples, Y, rest);
  }
  for (int i = 0; i < n; ++i) norm_.forward(kernels, Y.data + i * Y.stride);
  output_.forward(kernels, Y, n, velocities);

  for (int sample = 0; sample < samples; ++sample) {
    float* v = V.data + sample * V.stride;
    std::fill(v + horizon_ * action_size_, v + padded(horizon_ * action_size_), 0.0f);
    for (int j = 0; j < horizon_; ++j) {
      std::copy_n(velocities.data + (sample * horizon_ + j) * narrow, action_size_,
                  v + j * action_size_);
    }
  }
}

}  // namespace tandem::policy
