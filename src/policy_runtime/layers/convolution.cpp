#include "policy_runtime/layers/convolution.h"

#include <array>
#include <cmath>
#include <cstring>

#include "policy_runtime/file/safetensors.h"
#include "policy_runtime/policy_error.h"
#include "policy_runtime/scratch.h"

namespace tandem::policy {
namespace {

constexpr int kTile = MapShape::kTile, kElements = 16;  // of a tile's transform: 4 x 4

int ceil_divide(int a, int b) { return (a + b - 1) / b; }

// Output pixels, or tiles, that are computed together: enough to use a weight often once it is in
// the cache, and few enough for the patches to stay there, too. Anything from 48 to 400 is equally
// fast (measured on a Zen 3). Strips are of about equal size, in whole blocks of the matrix
// product.
int strip_of(int all) {
  constexpr int kMost = 60, kBlock = 6;
  const int strips = ceil_divide(all, kMost);
  return std::min(all, ceil_divide(ceil_divide(all, strips), kBlock) * kBlock);
}

// Columns (ky, kx, channel), the channels of a pixel padded to in_stride.
WeightMatrix direct_weights(const ConvolutionWeights& weights, const ConvolutionShape& shape,
                            int in_stride) {
  const int k = shape.kernel, columns = k * k * in_stride;
  std::vector<float> rows(std::size_t(shape.out_channels) * columns);
  const float* weight = weights.weight.data();
  for (int o = 0; o < shape.out_channels; ++o) {
    for (int c = 0; c < shape.in_channels; ++c) {
      for (int i = 0; i < k * k; ++i) {
        rows[std::size_t(o) * columns + i * in_stride + c] = float(weights.scale[o] * *weight++);
      }
    }
  }
  return {rows, shape.out_channels, columns, Precision::kFloat32};
}

// G v
std::array<double, 4> transform(double v0, double v1, double v2) {
  return {v0, (v0 + v1 + v2) / 2, (v0 - v1 + v2) / 2, v2};
}

// U = G g G' for the kernel g of one output and input.
std::array<double, kElements> transform(const float* g) {
  std::array<double, 4> columns[3];
  for (int x = 0; x < 3; ++x) columns[x] = transform(g[x], g[3 + x], g[6 + x]);
  std::array<double, kElements> U;
  for (int y = 0; y < 4; ++y) {
    const auto row = transform(columns[0][y], columns[1][y], columns[2][y]);
    std::copy(row.begin(), row.end(), U.begin() + 4 * y);
  }
  return U;
}

std::vector<WeightMatrix> winograd_weights(const ConvolutionWeights& weights,
                                           const ConvolutionShape& shape, int in_stride) {
  std::vector<std::vector<float>> elements(
      kElements, std::vector<float>(std::size_t(shape.out_channels) * in_stride));
  const float* weight = weights.weight.data();
  for (int o = 0; o < shape.out_channels; ++o) {
    for (int c = 0; c < shape.in_channels; ++c, weight += 9) {
      const auto U = transform(weight);
      for (int i = 0; i < kElements; ++i) {
        elements[i][std::size_t(o) * in_stride + c] = float(weights.scale[o] * U[i]);
      }
    }
  }
  std::vector<WeightMatrix> matrices;
  for (const auto& rows : elements) {
    matrices.emplace_back(rows, shape.out_channels, in_stride, Precision::kFloat32);
  }
  return matrices;
}

}  // namespace

ConvolutionWeights ConvolutionWeights::take(SafetensorsFile& file, const std::string& name,
                                            const ConvolutionShape& shape) {
  const int k = shape.kernel;
  ConvolutionWeights weights;
  weights.weight = file.take(name + ".weight", {shape.out_channels, shape.in_channels, k, k});
  weights.scale.assign(shape.out_channels, 1.0);
  const std::vector<float> bias = file.take(name + ".bias", {shape.out_channels});
  weights.bias.assign(bias.begin(), bias.end());
  return weights;
}

ConvolutionWeights ConvolutionWeights::take_with_norm(SafetensorsFile& file,
                                                      const std::string& name,
                                                      const std::string& norm,
                                                      const ConvolutionShape& shape) {
  const int out = shape.out_channels, k = shape.kernel;
  ConvolutionWeights weights;
  weights.weight = file.take(name + ".weight", {out, shape.in_channels, k, k});
  const auto scale = file.take(norm + ".weight", {out}), offset = file.take(norm + ".bias", {out});
  const auto mean = file.take(norm + ".running_mean", {out});
  const auto variance = file.take(norm + ".running_var", {out});
  for (int o = 0; o < out; ++o) {
    if (variance[o] < 0.0f) {
      throw PolicyError(file.path() + ": tensor " + printable(norm + ".running_var") +
                        " is negative at element " + std::to_string(o) +
                        "; a variance is at least 0. Write the file again.");
    }
    weights.scale.push_back(scale[o] / std::sqrt(double{variance[o]} + kBatchNormEpsilon));
    weights.bias.push_back(offset[o] - mean[o] * weights.scale[o]);
  }
  return weights;
}

// A few tiles do not repay the larger weights when those come from memory. Microseconds on a Zen 3
// with cold caches, direct / Winograd: 512 channels at 3 x 3 pixels (4 tiles) 843 / 1458, at 6 x 6
// (9 tiles) 2360 / 2060; 128 channels 53 / 73 and 149 / 98. With warm caches Winograd takes half of
// the time from 9 tiles on.
Convolution::Method Convolution::fastest(const ConvolutionShape& shape, const MapShape& in) {
  constexpr int kFewestTiles = 9;
  const bool can = shape.kernel == 3 && shape.stride == 1 && in.pixel_stride % kPadding == 0;
  return can && in.tiles_down() * in.tiles_across() >= kFewestTiles ? Method::kWinograd
                                                                    : Method::kDirect;
}

Convolution::Convolution(const ConvolutionWeights& weights, const ConvolutionShape& shape,
                         const MapShape& in, Method method)
    : shape_(shape),
      method_(method),
      out_height_(shape.out_side(in.height)),
      out_width_(shape.out_side(in.width)),
      in_stride_(in.pixel_stride),
      bias_(shape.out_channels),
      zero_(shape.out_channels) {
  std::copy(weights.bias.begin(), weights.bias.end(), bias_.data());
  if (method == Method::kDirect) {
    weights_.push_back(direct_weights(weights, shape, in_stride_));
    strip_ = strip_of(out_height_ * out_width_);
  } else {
    weights_ = winograd_weights(weights, shape, in_stride_);
    strip_ = strip_of(in.tiles_down() * in.tiles_across());
  }
}

std::size_t Convolution::workspace_size() const noexcept {
  const std::size_t out = padded(shape_.out_channels);
  if (method_ == Method::kDirect) return strip_ * (padded(weights_[0].columns()) + out);
  return kElements * (strip_ * (in_stride_ + out) + 2 * kPadding);
}

void Convolution::forward(const Kernels& kernels, const Map& in, const Map& residual,
                          const Map& out, float* workspace) const noexcept {
  if (method_ == Method::kDirect) {
    forward_direct(kernels, in, residual, out, workspace);
  } else {
    forward_winograd(kernels, in, residual, out, workspace);
  }
}

void Convolution::forward_direct(const Kernels& kernels, const Map& in, const Map& residual,
                                 const Map& out, float* workspace) const noexcept {
  const WeightMatrix& W = weights_[0];
  Scratch scratch(workspace);
  const std::size_t K = padded(W.columns()), O = padded(shape_.out_channels);
  const Rows patches{scratch.take(strip_ * K), K}, Y{scratch.take(strip_ * O), O};
  const int pixels = out_height_ * out_width_;
  for (int first = 0; first < pixels; first += strip_) {
    const int n = std::min(strip_, pixels - first);
    gather(in, first, n, patches);
    kernels.gemm(W.packed(), {bias_.data(), 0}, patches, n, Y);
    for (int i = 0; i < n; ++i) {
      const int y = (first + i) / out_width_, x = (first + i) % out_width_;
      finish(Y.data + i * O, residual.first ? residual.pixel(y, x) : nullptr, out.pixel(y, x));
    }
  }
}

// Rows of patches: pixels first.. of the output, (ky, kx, channel) each.
void Convolution::gather(const Map& in, int first, int n, Rows patches) const noexcept {
  // A row of a patch is a run of floats. They are copied by fours, at most 3 too many: the next
  // run, or zeros, overwrite those in the patch, and a map has a cache line to spare behind its
  // end.
  constexpr int kStep = 4;
  const int k = shape_.kernel, run = k * int(in_stride_);
  int y = first / out_width_, x = first % out_width_;
  for (int i = 0; i < n; ++i) {
    const float* from =
        in.pixel(y * shape_.stride - shape_.padding(), x * shape_.stride - shape_.padding());
    float *patch = patches.data + i * patches.stride, *end = patch + patches.stride;
    for (int ky = 0; ky < k; ++ky, from += in.row_stride, patch += run) {
      for (int j = 0; j < run; j += kStep) std::memcpy(patch + j, from + j, kStep * sizeof(float));
    }
    std::fill(patch, end, 0.0f);
    if (++x == out_width_) x = 0, ++y;
  }
}

// out = relu(sum + residual). Cache line by cache line through a local copy, which the compiler
// keeps in registers.
void Convolution::finish(const float* sum, const float* residual, float* out) const noexcept {
  const std::size_t O = padded(shape_.out_channels);
  for (std::size_t begin = 0; begin < O; begin += kPadding) {
    float line[kPadding];
    std::memcpy(line, sum + begin, sizeof line);
    if (residual) {
      for (int i = 0; i < kPadding; ++i) line[i] += residual[begin + i];
    }
    if (shape_.relu) {
      for (float& value : line) value = value > 0.0f ? value : 0.0f;
    }
    std::memcpy(out + begin, line, sizeof line);
  }
}

void Convolution::forward_winograd(const Kernels& kernels, const Map& in, const Map& residual,
                                   const Map& out, float* workspace) const noexcept {
  const std::size_t C = in_stride_, O = padded(shape_.out_channels);
  // one cache line apart, or all elements of a tile would share a few lines of the cache
  const std::size_t V_stride = strip_ * C + kPadding, M_stride = strip_ * O + kPadding;
  Scratch scratch(workspace);
  float *V = scratch.take(kElements * V_stride), *M = scratch.take(kElements * M_stride);

  const int across = ceil_divide(out_width_, kTile);
  const int tiles = ceil_divide(out_height_, kTile) * across;
  for (int first = 0; first < tiles; first += strip_) {
    const int n = std::min(strip_, tiles - first);
    for (int t = 0; t < n; ++t) {
      const int y = (first + t) / across * kTile, x = (first + t) % across * kTile;
      kernels.winograd_input(in.pixel(y - 1, x - 1), in.row_stride, int(C), V + t * C, V_stride);
    }
    for (int i = 0; i < kElements; ++i) {
      // element (1, 1) enters all four outputs with factor 1: the bias goes there
      const float* bias = i == 5 ? bias_.data() : zero_.data();
      kernels.gemm(weights_[i].packed(), {bias, 0}, {V + i * V_stride, C}, n,
                   {M + i * M_stride, O});
    }
    for (int t = 0; t < n; ++t) {
      const int y = (first + t) / across * kTile, x = (first + t) % across * kTile;
      const WinogradOutput tile{
          .channels = int(O),
          .height = std::min(kTile, out_height_ - y),
          .width = std::min(kTile, out_width_ - x),
          .relu = shape_.relu,
          .residual = residual.first ? residual.pixel(y, x) : nullptr,
          .residual_row_stride = residual.row_stride,
          .residual_pixel_stride = residual.pixel_stride,
          .out = out.pixel(y, x),
          .out_row_stride = out.row_stride,
          .out_pixel_stride = out.pixel_stride,
      };
      kernels.winograd_output(M + t * O, M_stride, tile);
    }
  }
}

}  // namespace tandem::policy
