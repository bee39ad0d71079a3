#pragma once

#include <string>
#include <vector>

#include "policy_runtime/policies/observation_tokens.h"
#include "policy_runtime/policies/velocity_field.h"

namespace tandem::policy {

/// The velocity field of a transformer: every step of the chunk is a query that looks at the others
/// and at tokens of the observation.
///
///   memory = encoder([W_i x_i + b_i, ...])
///   y_j    = W_a a_j + b_a + P_j + W_t phi(t)
///   v_j    = W_v norm(decoder(y, memory))_j + b_v
///
/// The memory, with its keys and values, is computed once per observe(); the time's part at load.
class TransformerField final : public VelocityField {
 public:
  struct Config {
    TransformerConfig transformer;
    int encoder_layers = 0;
    int decoder_layers = 1;
    ObservationTokens tokens;

    /// Reads the keys of TransformerConfig, encoder_layers, decoder_layers and tokens.
    /// @throws PolicyError
    static Config read(ConfigReader& reader, int observation_size);
  };

  /// Takes PREFIX.tokens.{i}, .token_position (T, d), .encoder.{l}, .action.weight (d, A) .bias,
  /// .time.weight (d, F), .query_position (h, d), .decoder.{l}, .norm, .output.weight (A, d) .bias.
  /// @param phi (K, F) the time features of every step
  /// @throws PolicyError
  TransformerField(SafetensorsFile& file, const std::string& prefix, const Config& config,
                   int horizon, int action_size, const std::vector<std::vector<double>>& phi);

  std::size_t workspace_size(int samples) const noexcept override;
  void observe(const float* x, float* workspace) const noexcept override;
  void velocity(int step, ConstRows A, int samples, Rows V,
                float* workspace) const noexcept override;

 private:
  static std::vector<DecoderLayer> load_decoder(SafetensorsFile& file, const std::string& prefix,
                                                const Config& config, const PositionRows& positions,
                                                const PositionRows& memory_positions);
  static Embedding load_action(SafetensorsFile& file, const std::string& prefix,
                               const PositionRows& positions, int action_size,
                               const Projection& projection);
  static AlignedBuffer load_time(SafetensorsFile& file, const std::string& prefix, int d,
                                 const std::vector<std::vector<double>>& phi,
                                 const Projection& projection);

  // Keys and values of the memory for one decoder layer lie at the beginning of the workspace.
  Rows memory_of(std::size_t layer, float* workspace) const noexcept {
    return {workspace + layer * encoder_.tokens() * padded(2 * d_), padded(2 * d_)};
  }
  std::size_t memory_size() const noexcept {
    return layers_.size() * encoder_.tokens() * padded(2 * d_);
  }
  std::size_t row_stride() const noexcept {
    return Embedding::width(d_, &layers_.front().projection());
  }

  int horizon_, action_size_, d_;
  ObservationTokens tokens_;
  PositionRows query_positions_;
  PositionRows positions_;  // of the memory
  Encoder encoder_;
  std::vector<DecoderLayer> layers_;
  Embedding action_;
  AlignedBuffer time_;  // (K, row_stride()): what the time adds to the decoder's first rows
  LayerNorm norm_;
  Dense output_;
};

}  // namespace tandem::policy
