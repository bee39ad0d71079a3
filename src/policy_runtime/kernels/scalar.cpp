#include <algorithm>
#include <bit>
#include <cmath>

#include "policy_runtime/kernels/kernels.h"

namespace tandem::policy {
namespace {

float element(const PackedMatrix& W, int row, int column) {
  const int panel = row / kPadding;
  const std::size_t index =
      (std::size_t(panel) * W.padded_columns() + column) * kPadding + row % kPadding;
  if (W.precision == Precision::kFloat32) return W.data[index];
  return std::bit_cast<float>(std::uint32_t{W.data_bf16[index]} << 16);
}

void gemv(const PackedMatrix& W, const float* b, const float* x, float* y) {
  for (int row = 0; row < W.rows; ++row) {
    float sum = b[row];
    for (int column = 0; column < W.columns; ++column) sum += element(W, row, column) * x[column];
    y[row] = sum;
  }
  std::fill(y + W.rows, y + padded(W.rows), 0.0f);
}

void gemm(const PackedMatrix& W, ConstRows bias, ConstRows X, int n, Rows Y) {
  for (int i = 0; i < n; ++i) {
    gemv(W, bias.data + i * bias.stride, X.data + i * X.stride, Y.data + i * Y.stride);
  }
}

void layer_norm(const float* scale, const float* offset, float epsilon, float* y, int n) {
  double mean = 0.0;
  for (int i = 0; i < n; ++i) mean += y[i];
  mean /= n;
  double variance = 0.0;
  for (int i = 0; i < n; ++i) variance += (y[i] - mean) * (y[i] - mean);
  variance /= n;
  const double inverse = 1.0 / std::sqrt(variance + epsilon);
  for (int i = 0; i < n; ++i) y[i] = float((y[i] - mean) * inverse) * scale[i] + offset[i];
}

float apply(Activation f, float x) {
  constexpr float kSqrtTwoOverPi = 0.7978845608f;
  switch (f) {
    case Activation::kRelu:
      return std::max(x, 0.0f);
    case Activation::kTanh:
      return std::tanh(x);
    case Activation::kGelu:
      return 0.5f * x * (1.0f + std::tanh(kSqrtTwoOverPi * (x + 0.044715f * x * x * x)));
    case Activation::kIdentity:
      break;
  }
  return x;
}

void activate(Activation f, float* y, int n) {
  for (int i = 0; i < n; ++i) y[i] = apply(f, y[i]);
}

void attention(const AttentionShape& shape, ConstRows Q, ConstRows K, ConstRows V, Rows out,
               float* scratch) {
  for (int head = 0; head < shape.heads; ++head) {
    const int begin = head * shape.head_size, end = begin + shape.head_size;
    for (int i = 0; i < shape.n_queries; ++i) {
      float* scores = scratch;  // (n_keys)
      float largest = -INFINITY;
      for (int j = 0; j < shape.n_keys; ++j) {
        scores[j] = 0.0f;
        for (int c = begin; c < end; ++c) {
          scores[j] += Q.data[i * Q.stride + c] * K.data[j * K.stride + c];
        }
        largest = std::max(largest, scores[j]);
      }
      float total = 0.0f;
      for (int j = 0; j < shape.n_keys; ++j) total += scores[j] = std::exp(scores[j] - largest);
      for (int c = begin; c < end; ++c) {
        float sum = 0.0f;
        for (int j = 0; j < shape.n_keys; ++j) sum += scores[j] * V.data[j * V.stride + c];
        out.data[i * out.stride + c] = sum / total;
      }
    }
  }
}

void winograd_input(const float* D, std::size_t row_stride, int channels, float* V,
                    std::size_t stride) {
  constexpr float B[4][4] = {{1, 0, 0, 0}, {0, 1, -1, 1}, {-1, 1, 1, 0}, {0, 0, 0, -1}};
  for (int c = 0; c < channels; ++c) {
    for (int i = 0; i < 16; ++i) {
      float sum = 0.0f;
      for (int y = 0; y < 4; ++y) {
        for (int x = 0; x < 4; ++x) {
          sum += B[y][i / 4] * B[x][i % 4] * D[y * row_stride + std::size_t(x) * channels + c];
        }
      }
      V[i * stride + c] = sum;
    }
  }
}

void winograd_output(const float* M, std::size_t stride, const WinogradOutput& tile) {
  constexpr float A[4][2] = {{1, 0}, {1, 1}, {1, -1}, {0, -1}};
  for (int y = 0; y < tile.height; ++y) {
    for (int x = 0; x < tile.width; ++x) {
      for (int c = 0; c < tile.channels; ++c) {
        float sum = 0.0f;
        for (int i = 0; i < 16; ++i) sum += A[i / 4][y] * A[i % 4][x] * M[i * stride + c];
        if (tile.residual) {
          sum += tile.residual[y * tile.residual_row_stride + x * tile.residual_pixel_stride + c];
        }
        if (tile.relu) sum = apply(Activation::kRelu, sum);
        tile.out[y * tile.out_row_stride + x * tile.out_pixel_stride + c] = sum;
      }
    }
  }
}

}  // namespace

const Kernels& scalar_kernels() {
  static constexpr Kernels kTable = {"scalar", gemv,      gemm,           layer_norm,
                                     activate, attention, winograd_input, winograd_output};
  return kTable;
}

}  // namespace tandem::policy
