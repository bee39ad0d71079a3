#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "policy_runtime/file/config_reader.h"
#include "policy_runtime/layers/convolution.h"

namespace tandem::policy {

class SafetensorsFile;

/// A convolutional network from an image to a smaller map of features: normalised pixels, then
/// convolutions and a max pool, one after the other. Made for images of one size; load it again for
/// another size. Immutable.
class Backbone {
 public:
  static constexpr int kMinSide = 8, kMaxSide = 1024;  ///< pixels of an image's height and width
  static constexpr int kMaxChannels = 2048;
  static constexpr int kMaxLayers = 16;
  static constexpr std::size_t kMaxMapFloats = std::size_t{1} << 26;  ///< of any map on the way

  int out_height() const noexcept { return out_.height; }
  int out_width() const noexcept { return out_.width; }
  int channels() const noexcept { return out_.channels; }

  /// Floats of scratch that forward() needs. It may hold anything before.
  std::size_t workspace_size() const noexcept;

  /// image (height, width, 3) bytes, RGB -> features (out_height out_width, channels), pixels row
  /// by row, each padded with zeros: stride at least padded(channels). Real-time.
  void forward(const Kernels& kernels, const std::uint8_t* image, Rows features,
               float* workspace) const noexcept;

 private:
  friend class BackboneBuilder;
  static constexpr int kBuffers = 3;

  // A map in one of the buffers, or the caller's features.
  struct Operand {
    std::optional<int> buffer;  // none: the features
    MapShape shape;
  };

  // A convolution, or else the 3 x 3 max pool of stride 2.
  struct Step {
    std::optional<Convolution> convolution;
    Operand in, out;
    std::optional<Operand> residual;  // may share the buffer of out
  };

  Backbone() = default;

  Operand image_;
  MapShape out_;
  std::array<std::array<float, 256>, 3> pixel_{};  // the normalised value of every byte
  std::vector<Step> steps_;
  std::array<std::size_t, kBuffers> buffer_sizes_{};  // floats
  std::size_t scratch_size_ = 0;                      // floats: of the neediest convolution
};

/// Takes PREFIX.image.mean (3), .image.scale (3) and PREFIX.backbone.*; a pixel enters as (byte /
/// 255
/// - mean) * scale. The config's kind is one of
///   resnet18  {"kind", "width": w}: torchvision's ResNet-18 up to layer4, channels w, 2w, 4w, 8w,
///             by torchvision's names; its batch norms (epsilon 1e-5) are folded into the weights.
///   cnn       {"kind", "layers": [{"channels", "kernel", "stride"}, ...]}: convolution (zero
///   padding
///             kernel / 2) + bias + relu each; tensors {i}.weight (out, in, k, k), {i}.bias (out).
/// @throws PolicyError
Backbone load_backbone(SafetensorsFile& file, const std::string& prefix, ConfigReader config,
                       int height, int width);

}  // namespace tandem::policy
