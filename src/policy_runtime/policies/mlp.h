#pragma once

#include <memory>
#include <vector>

#include "policy_runtime/layers/dense.h"
#include "policy_runtime/policy.h"

namespace tandem::policy {

/// Multi-layer perceptron with a bounded output:
///
///   x = (observation - mean) * scale
///   x = act(LN(W_i x + b_i))          for each hidden layer
///   chunk = tanh(W x + b)
///
/// LN only when the config says so; the chunk (h A) is row-major (h, A).
class Mlp final : public Policy {
 public:
  /// The network as the file's config describes it, checked against the limits in mlp.cpp.
  struct Config {
    std::vector<int> hidden;  ///< width of each hidden layer; empty = a linear policy
    Activation activation = Activation::kRelu;
    bool layer_norm = false;
    int horizon = 1;  ///< h
  };

  /// Everything learnt; immutable after load.
  struct Weights {
    std::vector<float> mean;    ///< (O)
    std::vector<float> scale;   ///< (O), one over the standard deviation
    std::vector<Dense> layers;  ///< hidden layers, then the output layer (h A)
    AlignedBuffer arena;        ///< what the layers point into
  };

  Mlp(Header header, Config config, Weights weights);

  const Config& config() const { return config_; }
  bool forward(const float* observation, float* chunk,
               Workspace& workspace) const noexcept override;

 private:
  std::size_t workspace_size() const noexcept override;

  Config config_;
  Weights weights_;
  std::size_t input_size_;  // floats: the padded observation
  std::size_t layer_size_;  // floats: the widest padded layer
};

/// Takes the tensors actor.layers.{i}.* and normalizer.* and fills in header.horizon.
/// @throws PolicyError
std::unique_ptr<Policy> load_mlp(SafetensorsFile& file, Header header);

}  // namespace tandem::policy
