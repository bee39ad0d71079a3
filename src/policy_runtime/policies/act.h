#pragma once

#include <vector>

#include "policy_runtime/policies/camera_tokens.h"
#include "policy_runtime/policies/head.h"
#include "policy_runtime/policies/observation_tokens.h"

namespace tandem::policy {

/// Action chunking with transformers (ACT), as LeRobot runs it: a post-norm encoder over a latent,
/// slices of the observation and image features; h learned queries decode it to a chunk.
///
///   memory  = encoder([W_l z + b_l, W_i x_i + b_i, ..., features])
///   queries = norm(decoder(zeros, memory))
///   chunk_j = f(W_o queries_j + b_o),  f = tanh, or action * scale + offset
///
/// The latent z is zero, or normal noise when the policy was made with sample_latent.
///
/// Config: horizon, model_size, heads, feedforward, encoder_layers, decoder_layers, activation,
/// latent_size, sample_latent, tokens, cameras, backbone, output ("tanh" or "linear").
class ActHead final : public Head {
 public:
  ActHead(SafetensorsFile& file, ConfigReader config, const HeadSpec& spec);

  int noise_size() const noexcept override { return sample_latent_ ? latent_size_ : 0; }
  const std::vector<Camera>& cameras() const noexcept override { return cameras_.cameras(); }
  std::size_t workspace_size(int samples) const noexcept override;
  void forward(const HeadInput& input, int samples, float* chunks,
               float* workspace) const noexcept override;

 private:
  struct Config {
    int horizon = 1;
    TransformerConfig transformer;
    int encoder_layers = 1;
    int decoder_layers = 1;
    int latent_size = 1;
    bool sample_latent = false;
    ObservationTokens tokens;
    CameraTokens::Config cameras;
    bool tanh = true;

    static Config read(ConfigReader& reader, const HeadSpec& spec);
  };
  ActHead(SafetensorsFile& file, const Config& config, const HeadSpec& spec);
  void decode(const Kernels& kernels, ConstRows memory, float* chunk,
              float* workspace) const noexcept;
  std::size_t decode_workspace_size() const noexcept;

  int d_;
  int action_size_;
  int latent_size_;
  bool sample_latent_;
  bool tanh_;
  ObservationTokens tokens_;
  CameraTokens cameras_;
  PositionRows query_positions_;
  PositionRows positions_;  // of the memory
  Encoder encoder_;
  FirstDecoderLayer first_layer_;
  std::vector<DecoderLayer> layers_;  // the others
  LayerNorm norm_;
  Dense action_;
  std::vector<float> scale_, offset_;  // (A), of a linear output
};

}  // namespace tandem::policy
