#pragma once

#include <optional>
#include <string>
#include <vector>

#include "policy_runtime/layers/map.h"
#include "policy_runtime/layers/weights.h"

namespace tandem::policy {

/// How a convolution looks at its input: zero padding of kernel / 2 on every side.
struct ConvolutionShape {
  int in_channels = 1;
  int out_channels = 1;
  int kernel = 1;  ///< odd
  int stride = 1;
  bool relu = true;

  int padding() const noexcept { return kernel / 2; }
  int out_side(int in_side) const noexcept { return (in_side - 1) / stride + 1; }
};

/// Weights as a file has them: y = scale (weight * x) + bias for every output.
struct ConvolutionWeights {
  static constexpr double kBatchNormEpsilon = 1e-5;

  std::vector<float> weight;  ///< (out, in, kernel, kernel)
  std::vector<double> scale;  ///< (out)
  std::vector<double> bias;   ///< (out)

  /// NAME.weight and NAME.bias. @throws PolicyError
  static ConvolutionWeights take(SafetensorsFile& file, const std::string& name,
                                 const ConvolutionShape& shape);

  /// NAME.weight and a batch norm frozen in NORM.{weight, bias, running_mean, running_var}.
  /// @throws PolicyError also when a variance is negative
  static ConvolutionWeights take_with_norm(SafetensorsFile& file, const std::string& name,
                                           const std::string& norm, const ConvolutionShape& shape);
};

/// y = relu(W * x + bias + residual), relu and residual optional.
///
/// kDirect copies the patches under a strip of output pixels into rows of a matrix and multiplies
/// that. kWinograd computes 2 x 2 outputs of a 3 x 3 kernel at stride 1 from 4 x 4 inputs with 16
/// multiplications instead of 36 (Lavin and Gray, arXiv 1509.09308), as 16 matrix products over
/// tiles; its weights take 16/9 of the memory.
class Convolution {
 public:
  enum class Method { kDirect, kWinograd };

  /// The faster method for a map of this size.
  static Method fastest(const ConvolutionShape& shape, const MapShape& in);

  /// @param in the maps that forward() will see; its frame is at least shape.padding()
  Convolution(const ConvolutionWeights& weights, const ConvolutionShape& shape, const MapShape& in,
              Method method);

  /// Floats of scratch. It may hold anything before.
  std::size_t workspace_size() const noexcept;

  /// in -> out (out_side(height), out_side(width), padded(out_channels)). `residual` is a map like
  /// out or has no first pixel; it may be out itself. Frames are left alone. Real-time.
  void forward(const Kernels& kernels, const Map& in, const Map& residual, const Map& out,
               float* workspace) const noexcept;

 private:
  void forward_direct(const Kernels& kernels, const Map& in, const Map& residual, const Map& out,
                      float* workspace) const noexcept;
  void forward_winograd(const Kernels& kernels, const Map& in, const Map& residual, const Map& out,
                        float* workspace) const noexcept;
  void gather(const Map& in, int first, int n, Rows patches) const noexcept;
  void finish(const float* sum, const float* residual, float* out) const noexcept;

  ConvolutionShape shape_;
  Method method_;
  int out_height_, out_width_;
  std::size_t in_stride_;              // floats of an input pixel
  int strip_;                          // output pixels, or tiles, that are computed together
  std::vector<WeightMatrix> weights_;  // one; with Winograd 16
  AlignedBuffer bias_, zero_;          // (out)
};

}  // namespace tandem::policy
