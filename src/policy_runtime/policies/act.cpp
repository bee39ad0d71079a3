#include "policy_runtime/policies/act.h"

#include <algorithm>
#include <utility>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

constexpr int kMaxLatent = 1024;

std::vector<Encoder::Token> memory_tokens(const std::string& prefix, int latent_size,
                                          const ObservationTokens& tokens) {
  std::vector<Encoder::Token> all = tokens.of_encoder(prefix);
  all.insert(all.begin(), {prefix + ".latent", latent_size});
  return all;
}

PositionRows memory_positions(SafetensorsFile& file, const std::string& prefix, int n_tokens, int d,
                              const CameraTokens& cameras) {
  std::vector<float> all = file.take(prefix + ".token_position", {n_tokens, d});
  all.insert(all.end(), cameras.positions().begin(), cameras.positions().end());
  return {all, n_tokens + cameras.count(), d};
}

}  // namespace

ActHead::Config ActHead::Config::read(ConfigReader& reader, const HeadSpec& spec) {
  Config config;
  config.horizon = reader.integer("horizon", 1, kMaxHorizon);
  config.transformer = TransformerConfig::read(reader);
  config.encoder_layers = reader.integer("encoder_layers", 1, kMaxLayers);
  config.decoder_layers = reader.integer("decoder_layers", 1, kMaxLayers);
  config.latent_size = reader.integer("latent_size", 1, kMaxLatent);
  config.sample_latent = reader.boolean("sample_latent");
  config.tokens = ObservationTokens::read(reader, spec.observation_size);
  config.cameras = CameraTokens::Config::read(reader);
  config.tanh = reader.choice("output", {"tanh", "linear"}) == 0;
  reader.finish();
  return config;
}

ActHead::ActHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec)
    : ActHead(file, Config::read(config, spec), spec) {}

ActHead::ActHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec)
    : Head(config.horizon, spec.action_size),
      d_(config.transformer.model_size),
      action_size_(spec.action_size),
      latent_size_(config.latent_size),
      sample_latent_(config.sample_latent),
      tanh_(config.tanh),
      tokens_(config.tokens),
      cameras_(file, spec.prefix, config.cameras, d_),
      query_positions_(file.take(spec.prefix + ".query_position", {config.horizon, d_}),
                       config.horizon, d_),
      positions_(memory_positions(file, spec.prefix, 1 + tokens_.count(), d_, cameras_)),
      encoder_(file, spec.prefix + ".encoder", config.transformer, config.encoder_layers,
               memory_tokens(spec.prefix, latent_size_, tokens_), positions_),
      first_layer_(file, spec.prefix + ".decoder.0", config.transformer, query_positions_,
                   positions_),
      norm_(take_layer_norm(file, spec.prefix + ".norm", d_)),
      action_(file, spec.prefix + ".action", d_, action_size_, false, Activation::kIdentity) {
  for (int i = 1; i < config.decoder_layers; ++i) {
    layers_.emplace_back(file, spec.prefix + ".decoder." + std::to_string(i), config.transformer,
                         query_positions_, positions_);
  }
  if (!tanh_) {
    scale_ = file.take(spec.prefix + ".output.scale", {action_size_});
    offset_ = file.take(spec.prefix + ".output.offset", {action_size_});
  }
}

// the encoder's first rows | memory | latent | what tokens, cameras, encoder or decoder need
std::size_t ActHead::workspace_size(int) const noexcept {
  return encoder_.tokens() * (encoder_.row_stride() + padded(d_)) + padded(latent_size_) +
         std::max({tokens_.workspace_size(), cameras_.workspace_size(), encoder_.workspace_size(),
                   decode_workspace_size()});
}

void ActHead::forward(const HeadInput& input, int samples, float* chunks,
                      float* workspace) const noexcept {
  const Kernels& kernels = policy::kernels();
  Scratch scratch(workspace);
  const Rows rows{scratch.take(encoder_.tokens() * encoder_.row_stride()), encoder_.row_stride()};
  const Rows memory{scratch.take(encoder_.tokens() * padded(d_)), padded(d_)};
  float* latent = scratch.take(latent_size_);
  float* rest = scratch.take(0);

  tokens_.embed(kernels, encoder_, 1, input.x, rows, rest);
  const int features = 1 + tokens_.count();  // where they begin
  cameras_.forward(kernels, input.images, {rows.data + features * rows.stride, rows.stride}, rest);
  encoder_.embed_features(kernels, rows);
  const std::size_t stride = padded(chunk_size());
  for (int sample = 0; sample < samples; ++sample) {
    float* chunk = chunks + sample * stride;
    if (sample > 0 && !sample_latent_) {
      std::copy_n(chunks, stride, chunk);
      continue;
    }
    if (sample_latent_) {
      const float* z = input.noise + std::size_t(sample) * latent_size_;
      std::fill(std::copy_n(z, latent_size_, latent), latent + padded(latent_size_), 0.0f);
      encoder_.embed(kernels, 0, latent, rows);
    } else {
      encoder_.embed_zeros(0, rows);
    }
    encoder_.forward(kernels, rows, memory, rest);
    decode(kernels, memory, chunk, rest);
  }
}

// queries | the memory's keys and values | projection of all layers but the first | a layer's own
std::size_t ActHead::decode_workspace_size() const noexcept {
  std::size_t of_layer = first_layer_.workspace_size();
  if (!layers_.empty()) of_layer = std::max(of_layer, layers_.front().workspace_size(1));
  return horizon() * (padded(d_) + padded(3 * d_) + padded(action_size_)) +
         encoder_.tokens() * padded(2 * d_) + of_layer;
}

// memory (T, d) -> chunk (h A)
void ActHead::decode(const Kernels& kernels, ConstRows memory, float* chunk,
                     float* workspace) const noexcept {
  Scratch scratch(workspace);
  const int h = horizon(), tokens = encoder_.tokens();
  const Rows Y{scratch.take(h * padded(d_)), padded(d_)};
  const Rows QKV{scratch.take(h * padded(3 * d_)), padded(3 * d_)};
  const Rows KV{scratch.take(tokens * padded(2 * d_)), padded(2 * d_)};
  const Rows actions{scratch.take(h * padded(action_size_)), padded(action_size_)};
  float* rest = scratch.take(0);

  first_layer_.memory_projection().forward(kernels, memory, tokens, KV);
  first_layer_.forward(kernels, KV, Y, rest);
  for (const DecoderLayer& layer : layers_) {
    layer.projection().forward(kernels, Y, h, QKV);
    layer.memory_projection().forward(kernels, memory, tokens, KV);
    layer.forward(kernels, Y, QKV, KV, 1, Y, rest);
  }
  for (int j = 0; j < h; ++j) norm_.forward(kernels, Y.data + j * Y.stride);
  action_.forward(kernels, Y, h, actions);

  for (int j = 0; j < h; ++j) {
    const float* action = actions.data + j * actions.stride;
    float* out = chunk + j * action_size_;
    for (int a = 0; a < action_size_; ++a) {
      out[a] = tanh_ ? action[a] : action[a] * scale_[a] + offset_[a];
    }
  }
  std::fill(chunk + chunk_size(), chunk + padded(chunk_size()), 0.0f);
  if (tanh_) kernels.activate(Activation::kTanh, chunk, chunk_size());
}

}  // namespace tandem::policy
