#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "policy_runtime/policy_file.h"

/// Random tensors of backbones, and the same networks in double precision, straight from the
/// formulas.
namespace tandem::policy::testing {

/// (height, width, channels), row-major.
struct Volume {
  int height = 0, width = 0, channels = 0;
  std::vector<double> values;

  double& at(int y, int x, int c) { return values[(std::size_t(y) * width + x) * channels + c]; }
  double at(int y, int x, int c) const {
    return values[(std::size_t(y) * width + x) * channels + c];
  }
};

struct CnnLayer {
  int channels, kernel, stride;
};

/// The tensors of PREFIX = "actor" alone: no policy, but a sound safetensors file.
PolicyFile make_resnet18(int width, unsigned seed = 1);
PolicyFile make_cnn(const std::vector<CnnLayer>& layers, unsigned seed = 1);

/// A backbone's config as JSON text.
std::string resnet18_config(int width);
std::string cnn_config(const std::vector<CnnLayer>& layers);

/// (height, width, 3) random bytes.
std::vector<std::uint8_t> random_image(int height, int width, unsigned seed = 1);

/// Zero padding kernel / 2, weight (out, in, kernel, kernel), no bias.
Volume convolve(const Volume& in, const Tensor& weight, int stride);

Volume evaluate_resnet18(const PolicyFile& file, const std::vector<std::uint8_t>& image, int height,
                         int width);
Volume evaluate_cnn(const PolicyFile& file, const std::vector<CnnLayer>& layers,
                    const std::vector<std::uint8_t>& image, int height, int width);

}  // namespace tandem::policy::testing
