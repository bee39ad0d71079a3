#include "policy_runtime/layers/transformer.h"

#include <algorithm>

#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

constexpr int kMaxModelSize = 4096;
constexpr int kMaxHeads = 64;
constexpr int kMaxFeedForward = 16384;

// What self-attention makes of zeros.
AlignedBuffer attend_to_zeros(const SelfAttention& attention, int n, int d) {
  const AlignedBuffer zeros(n * padded(d));
  AlignedBuffer qkv(n * padded(3 * d)), y(n * padded(d)), scratch(attention.workspace_size(1));
  const ConstRows X{zeros.data(), padded(d)};
  const Rows QKV{qkv.data(), padded(3 * d)};
  attention.projection().forward(kernels(), X, n, QKV);
  attention.forward(kernels(), X, QKV, 1, {y.data(), padded(d)}, scratch.data());
  return y;
}

AlignedBuffer project(const Projection& projection, const AlignedBuffer& x, int n) {
  AlignedBuffer y(n * padded(projection.out()));
  projection.forward(kernels(), {x.data(), padded(projection.in())}, n,
                     {y.data(), padded(projection.out())});
  return y;
}

}  // namespace

TransformerConfig TransformerConfig::read(ConfigReader& reader) {
  constexpr Activation kActivations[] = {Activation::kRelu, Activation::kGelu};
  const TransformerConfig config{
      .model_size = reader.integer("model_size", 1, kMaxModelSize),
      .heads = reader.integer("heads", 1, kMaxHeads),
      .feedforward = reader.integer("feedforward", 1, kMaxFeedForward),
      .activation = kActivations[reader.choice("activation", {"relu", "gelu"})]};
  if (config.model_size % config.heads != 0) {
    reader.refuse("has model_size " + std::to_string(config.model_size) + " and heads " +
                  std::to_string(config.heads) + "; heads must divide model_size.");
  }
  return config;
}

PositionRows::PositionRows(const std::vector<float>& row_major, int count, int d)
    : rows_(count * padded(d)), count_(count), d_(d) {
  for (int i = 0; i < count; ++i) {
    std::copy_n(row_major.begin() + std::size_t(i) * d, d, rows_.data() + i * padded(d));
  }
}

FeedForward::FeedForward(SafetensorsFile& file, const std::string& prefix, const std::string& norm,
                         const TransformerConfig& config)
    : first_(file, prefix + ".feedforward1", config.model_size, config.feedforward, false,
             config.activation),
      second_(file, prefix + ".feedforward2", config.feedforward, config.model_size, false,
              Activation::kIdentity),
      norm_(take_layer_norm(file, norm, config.model_size)) {}

void FeedForward::forward(const Kernels& kernels, ConstRows X, int n, Rows Y,
                          float* workspace) const noexcept {
  const Rows hidden{workspace, padded(first_.out())};
  first_.forward(kernels, X, n, hidden);
  second_.forward(kernels, hidden, n, Y);
  add_and_normalise(kernels, norm_, X, n, Y);
}

EncoderLayer::EncoderLayer(SafetensorsFile& file, const std::string& prefix,
                           const TransformerConfig& config, const PositionRows& positions)
    : tokens_(positions.count()),
      d_(config.model_size),
      attention_(file, prefix + ".attention", prefix + ".norm1", d_, config.heads, positions,
                 tokens_),
      feedforward_(file, prefix, prefix + ".norm2", config) {}

// attention's result | what attention or feed-forward need
std::size_t EncoderLayer::workspace_size() const noexcept {
  return tokens_ * padded(d_) +
         std::max(attention_.workspace_size(1), feedforward_.workspace_size(tokens_));
}

void EncoderLayer::forward(const Kernels& kernels, ConstRows X, ConstRows QKV, Rows Y,
                           float* workspace) const noexcept {
  Scratch scratch(workspace);
  const Rows attended{scratch.take(tokens_ * padded(d_)), padded(d_)};
  float* rest = scratch.take(0);
  attention_.forward(kernels, X, QKV, 1, attended, rest);
  feedforward_.forward(kernels, attended, tokens_, Y, rest);
}

DecoderLayer::DecoderLayer(SafetensorsFile& file, const std::string& prefix,
                           const TransformerConfig& config, const PositionRows& positions,
                           const PositionRows& memory_positions)
    : queries_(positions.count()),
      d_(config.model_size),
      self_(file, prefix + ".self_attention", prefix + ".norm1", d_, config.heads, positions,
            queries_),
      cross_(file, prefix + ".cross_attention", prefix + ".norm2", d_, config.heads, positions,
             queries_, memory_positions, memory_positions.count()),
      feedforward_(file, prefix, prefix + ".norm3", config) {}

// what looked at itself | its queries | what looked at the memory | what the parts need
std::size_t DecoderLayer::workspace_size(int samples) const noexcept {
  return 3 * samples * queries_ * padded(d_) +
         std::max({self_.workspace_size(samples), cross_.workspace_size(samples),
                   feedforward_.workspace_size(samples * queries_)});
}

void DecoderLayer::forward(const Kernels& kernels, ConstRows X, ConstRows QKV, ConstRows KV,
                           int samples, Rows Y, float* workspace) const noexcept {
  Scratch scratch(workspace);
  const int n = samples * queries_;
  const std::size_t stride = padded(d_), one = queries_ * stride;
  const Rows itself{scratch.take(n * stride), stride}, Q{scratch.take(n * stride), stride},
      looked{scratch.take(n * stride), stride};
  float* rest = scratch.take(0);
  self_.forward(kernels, X, QKV, samples, itself, rest);
  for (int sample = 0; sample < samples; ++sample) {
    cross_.query_projection().forward(kernels, {itself.data + sample * one, stride}, queries_,
                                      {Q.data + sample * one, stride});
  }
  cross_.forward(kernels, itself, Q, KV, samples, looked, rest);
  feedforward_.forward(kernels, looked, n, Y, rest);
}

FirstDecoderLayer::FirstDecoderLayer(SafetensorsFile& file, const std::string& prefix,
                                     const TransformerConfig& config, const PositionRows& positions,
                                     const PositionRows& memory_positions)
    : queries_(positions.count()),
      d_(config.model_size),
      x_(attend_to_zeros(SelfAttention(file, prefix + ".self_attention", prefix + ".norm1", d_,
                                       config.heads, positions, queries_),
                         queries_, d_)),
      cross_(file, prefix + ".cross_attention", prefix + ".norm2", d_, config.heads, positions,
             queries_, memory_positions, memory_positions.count()),
      q_(project(cross_.query_projection(), x_, queries_)),
      feedforward_(file, prefix, prefix + ".norm3", config) {}

// what looked at the memory | what the parts need
std::size_t FirstDecoderLayer::workspace_size() const noexcept {
  return queries_ * padded(d_) +
         std::max(cross_.workspace_size(1), feedforward_.workspace_size(queries_));
}

void FirstDecoderLayer::forward(const Kernels& kernels, ConstRows KV, Rows Y,
                                float* workspace) const noexcept {
  Scratch scratch(workspace);
  const std::size_t stride = padded(d_);
  const Rows looked{scratch.take(queries_ * stride), stride};
  float* rest = scratch.take(0);
  cross_.forward(kernels, {x_.data(), stride}, {q_.data(), stride}, KV, 1, looked, rest);
  feedforward_.forward(kernels, looked, queries_, Y, rest);
}

}  // namespace tandem::policy
