#include <algorithm>
#include <utility>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/layers/backbone.h"

namespace tandem::policy {

/// Puts a backbone together, step after step.
class BackboneBuilder {
 public:
  using Operand = Backbone::Operand;

  /// @param config refuses what is too large; it outlives the builder
  explicit BackboneBuilder(const ConfigReader& config) : config_(config) {}

  /// The normalised image, in buffer 0.
  Operand image(int height, int width, int frame, const std::vector<float>& mean,
                const std::vector<float>& scale) {
    const int channels = int(made_.pixel_.size());
    for (int c = 0; c < channels; ++c) {
      for (int byte = 0; byte < 256; ++byte) {
        made_.pixel_[c][byte] = float((byte / 255.0 - mean[c]) * scale[c]);
      }
    }
    // channels without padding: a row of a patch is one run of floats
    return made_.image_ = place({height, width, channels, frame, std::size_t(channels)}, 0);
  }

  /// relu(W * in + bias + residual), or without the relu. No buffer: these are the features.
  Operand convolve(const Operand& in, const ConvolutionWeights& weights,
                   const ConvolutionShape& shape, std::optional<int> buffer, int frame,
                   const std::optional<Operand>& residual = {}) {
    const int height = shape.out_side(in.shape.height), width = shape.out_side(in.shape.width);
    const Operand out =
        place({height, width, shape.out_channels, frame, padded(shape.out_channels)}, buffer);
    Convolution convolution(weights, shape, in.shape, Convolution::fastest(shape, in.shape));
    made_.scratch_size_ = std::max(made_.scratch_size_, convolution.workspace_size());
    made_.steps_.push_back({std::move(convolution), in, out, residual});
    made_.out_ = out.shape;
    return out;
  }

  /// The 3 x 3 max pool of stride 2.
  Operand pool(const Operand& in, int buffer, int frame) {
    MapShape shape = in.shape;
    shape.height = (shape.height + 1) / 2;
    shape.width = (shape.width + 1) / 2;
    shape.frame = frame;
    const Operand out = place(shape, buffer);
    made_.steps_.push_back({std::nullopt, in, out, std::nullopt});
    return out;
  }

  Backbone finish() { return std::move(made_); }

 private:
  Operand place(const MapShape& shape, std::optional<int> buffer) {
    if (shape.size() > Backbone::kMaxMapFloats) {
      config_.refuse("leads to a map of " + std::to_string(shape.height) + " x " +
                     std::to_string(shape.width) + " pixels with " +
                     std::to_string(shape.channels) + " channels; a map has at most " +
                     std::to_string(Backbone::kMaxMapFloats) + " numbers.");
    }
    if (buffer) {
      std::size_t& size = made_.buffer_sizes_[*buffer];
      size = std::max(size, shape.size());
    }
    return {buffer, shape};
  }

  const ConfigReader& config_;
  Backbone made_;
};

namespace {

using Operand = BackboneBuilder::Operand;

constexpr int kImageChannels = 3;

struct Image {
  int height, width;
  std::vector<float> mean, scale;
};

Backbone load_cnn(SafetensorsFile& file, const std::string& prefix, ConfigReader& config,
                  const Image& image) {
  constexpr int kMaxKernel = 7, kMaxStride = 4;
  std::vector<ConvolutionShape> shapes;
  int channels = kImageChannels;
  for (ConfigReader& layer : config.objects("layers", 1, Backbone::kMaxLayers)) {
    ConvolutionShape shape{channels, layer.integer("channels", 1, Backbone::kMaxChannels),
                           layer.integer("kernel", 1, kMaxKernel),
                           layer.integer("stride", 1, kMaxStride)};
    if (shape.kernel % 2 == 0) {
      layer.refuse("has the kernel " + std::to_string(shape.kernel) + "; it must be odd.");
    }
    layer.finish();
    shapes.push_back(shape);
    channels = shape.out_channels;
  }
  config.finish();

  BackboneBuilder builder(config);
  Operand x =
      builder.image(image.height, image.width, shapes[0].padding(), image.mean, image.scale);
  for (std::size_t i = 0; i < shapes.size(); ++i) {
    const bool last = i + 1 == shapes.size();
    const auto weights =
        ConvolutionWeights::take(file, prefix + "." + std::to_string(i), shapes[i]);
    const std::optional<int> next = last ? std::nullopt : std::optional(1 - *x.buffer);
    x = builder.convolve(x, weights, shapes[i], next, last ? 0 : shapes[i + 1].padding());
  }
  return builder.finish();
}

Backbone load_resnet18(SafetensorsFile& file, const std::string& prefix, ConfigReader& config,
                       const Image& image) {
  constexpr int kStages = 4, kBlocks = 2;
  constexpr int kFrame = 1;  // what the 3 x 3 kernels and the pool read
  const int width = config.integer("width", 1, Backbone::kMaxChannels >> (kStages - 1));
  config.finish();

  BackboneBuilder builder(config);
  const auto take = [&](const std::string& convolution, const std::string& norm,
                        const ConvolutionShape& shape) {
    return ConvolutionWeights::take_with_norm(file, prefix + "." + convolution, prefix + "." + norm,
                                              shape);
  };
  const ConvolutionShape first{kImageChannels, width, 7, 2};
  Operand x = builder.image(image.height, image.width, first.padding(), image.mean, image.scale);
  x = builder.convolve(x, take("conv1", "bn1", first), first, 1, kFrame);
  x = builder.pool(x, 0, kFrame);

  int channels = width;
  for (int stage = 0; stage < kStages; ++stage) {
    for (int block = 0; block < kBlocks; ++block) {
      const std::string name = "layer" + std::to_string(stage + 1) + "." + std::to_string(block);
      const int out = width << stage, stride = stage > 0 && block == 0 ? 2 : 1;
      const bool last = stage + 1 == kStages && block + 1 == kBlocks;
      const int inner = 1, beside = 2 - *x.buffer;  // x is in buffer 0 or 2

      const ConvolutionShape conv1{channels, out, 3, stride}, conv2{out, out, 3, 1};
      const Operand y =
          builder.convolve(x, take(name + ".conv1", name + ".bn1", conv1), conv1, inner, kFrame);
      Operand residual = x;
      if (stride != 1) {
        const ConvolutionShape down{channels, out, 1, stride, false};
        residual = builder.convolve(x, take(name + ".downsample.0", name + ".downsample.1", down),
                                    down, beside, kFrame);
      }
      x = builder.convolve(y, take(name + ".conv2", name + ".bn2", conv2), conv2,
                           last ? std::nullopt : residual.buffer, last ? 0 : kFrame, residual);
      channels = out;
    }
  }
  return builder.finish();
}

}  // namespace

Backbone load_backbone(SafetensorsFile& file, const std::string& prefix, ConfigReader config,
                       int height, int width) {
  const auto fits = [](int side) {
    return side >= Backbone::kMinSide && side <= Backbone::kMaxSide;
  };
  if (!fits(height) || !fits(width)) {
    config.refuse("is asked for images of " + std::to_string(height) + " x " +
                  std::to_string(width) + " pixels; height and width must be in [" +
                  std::to_string(Backbone::kMinSide) + ", " + std::to_string(Backbone::kMaxSide) +
                  "].");
  }
  const bool resnet = config.choice("kind", {"resnet18", "cnn"}) == 0;
  const Image image{height, width, file.take(prefix + ".image.mean", {kImageChannels}),
                    file.take(prefix + ".image.scale", {kImageChannels})};
  return (resnet ? load_resnet18 : load_cnn)(file, prefix + ".backbone", config, image);
}

}  // namespace tandem::policy
