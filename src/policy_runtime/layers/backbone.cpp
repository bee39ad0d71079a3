#include "policy_runtime/layers/backbone.h"

#include <algorithm>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

constexpr int kImageChannels = 3;

// The 3 x 3 max pool of stride 2 and padding 1, after a relu: the frame's zeros never win.
void max_pool(const Map& in, const MapShape& shape, const Map& out) {
  for (int y = 0; y < shape.height; ++y) {
    for (int x = 0; x < shape.width; ++x) {
      float* to = out.pixel(y, x);
      for (std::size_t c = 0; c < shape.pixel_stride; c += kPadding) {
        float largest[kPadding] = {};
        for (int window = 0; window < 9; ++window) {
          const float* from = in.pixel(2 * y - 1 + window / 3, 2 * x - 1 + window % 3) + c;
          for (int i = 0; i < kPadding; ++i) {
            largest[i] = from[i] > largest[i] ? from[i] : largest[i];
          }
        }
        std::copy_n(largest, kPadding, to + c);
      }
    }
  }
}

}  // namespace

std::size_t Backbone::workspace_size() const noexcept {
  std::size_t total = scratch_size_;
  for (const std::size_t size : buffer_sizes_) total += size;
  return total;
}

void Backbone::forward(const Kernels& kernels, const std::uint8_t* image, Rows features,
                       float* workspace) const noexcept {
  Scratch scratch(workspace);
  std::array<float*, kBuffers> buffers;
  for (int i = 0; i < kBuffers; ++i) buffers[i] = scratch.take(buffer_sizes_[i]);

  const auto map = [&](const Operand& operand) {
    return operand.buffer
               ? operand.shape.at(buffers[*operand.buffer])
               : Map{features.data, operand.shape.width * features.stride, features.stride};
  };
  const auto clear_frame = [&](const Operand& operand) {
    if (operand.buffer) operand.shape.clear_frame(buffers[*operand.buffer]);
  };

  clear_frame(image_);
  for (int y = 0; y < image_.shape.height; ++y) {
    float* row = map(image_).pixel(y, 0);
    for (int x = 0; x < image_.shape.width; ++x) {
      for (int c = 0; c < kImageChannels; ++c) *row++ = pixel_[c][*image++];
    }
  }

  for (const Step& step : steps_) {
    clear_frame(step.out);
    const Map residual = step.residual ? map(*step.residual) : Map{};
    if (step.convolution) {
      step.convolution->forward(kernels, map(step.in), residual, map(step.out), scratch.take(0));
    } else {
      max_pool(map(step.in), step.out.shape, map(step.out));
    }
  }
}

}  // namespace tandem::policy
