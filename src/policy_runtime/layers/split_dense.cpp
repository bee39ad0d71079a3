#include "policy_runtime/layers/split_dense.h"

#include <algorithm>
#include <cstdint>

#include "policy_runtime/file/safetensors.h"

namespace tandem::policy {
namespace {

// The tensors PREFIX + name (n), each from a multiple of kPadding on.
AlignedBuffer take_stacked(SafetensorsFile& file, const std::vector<std::string>& prefixes,
                           const std::string& name, int n) {
  AlignedBuffer stacked(prefixes.size() * padded(n));
  for (std::size_t m = 0; m < prefixes.size(); ++m) {
    const std::vector<float> values = file.take(prefixes[m] + name, {n});
    std::copy(values.begin(), values.end(), stacked.data() + m * padded(n));
  }
  return stacked;
}

}  // namespace

SplitDense::SplitDense(SafetensorsFile& file, const std::vector<std::string>& prefixes,
                       const SplitInput& input, int out, bool norm, Activation activation)
    : SplitDense(take(file, prefixes, input, out), file, prefixes, input, out, norm, activation) {}

SplitDense::SplitDense(const Matrices& matrices, SafetensorsFile& file,
                       const std::vector<std::string>& prefixes, const SplitInput& input, int out,
                       bool norm, Activation activation)
    : out_(out),
      W_observation_(matrices.observation, static_cast<int>(prefixes.size() * padded(out)),
                     input.observation,
                     matrices.bfloat16 ? Precision::kBfloat16 : Precision::kFloat32),
      W_action_(matrices.action, static_cast<int>(prefixes.size() * padded(out)), input.action,
                matrices.bfloat16 ? Precision::kBfloat16 : Precision::kFloat32),
      W_known_(matrices.known),
      b_(take_stacked(file, prefixes, ".bias", out)),
      activation_(activation) {
  if (norm) {
    norm_.emplace(LayerNorm{take_stacked(file, prefixes, ".norm_scale", out),
                            take_stacked(file, prefixes, ".norm_offset", out), Dense::kNormEpsilon,
                            out});
  }
}

SplitDense::Matrices SplitDense::take(SafetensorsFile& file,
                                      const std::vector<std::string>& prefixes,
                                      const SplitInput& input, int out) {
  const int x = input.observation, a = input.action;
  const int c = input.known.empty() ? 0 : static_cast<int>(input.known.front().size());
  for (const std::string& prefix : prefixes) {  // before anything is sized by these numbers
    file.check_shape(prefix + ".weight", {out, std::int64_t{x} + a + c});
  }
  const std::size_t width = prefixes.size() * padded(out);
  Matrices matrices{std::vector<float>(width * x), std::vector<float>(width * a),
                    std::vector<float>(input.known.size() * width)};
  for (std::size_t m = 0; m < prefixes.size(); ++m) {
    const std::string name = prefixes[m] + ".weight";
    const std::vector<float> W = file.take(name, {out, x + a + c});
    matrices.bfloat16 = matrices.bfloat16 && file.is_bfloat16(name);
    for (int i = 0; i < out; ++i) {
      const float* row = W.data() + std::size_t(i) * (x + a + c);
      const std::size_t stacked = m * padded(out) + i;
      std::copy_n(row, x, matrices.observation.data() + stacked * x);
      std::copy_n(row + x, a, matrices.action.data() + stacked * a);
      for (std::size_t k = 0; k < input.known.size(); ++k) {
        double sum = 0.0;
        for (int j = 0; j < c; ++j) sum += row[x + a + j] * input.known[k][j];
        matrices.known[k * width + stacked] = static_cast<float>(sum);
      }
    }
  }
  return matrices;
}

void SplitDense::observe(const Kernels& kernels, const float* x, float* base) const noexcept {
  kernels.gemv(W_observation_.packed(), b_.data(), x, base);
}

void SplitDense::shift(const float* base, int k, float* shifted) const noexcept {
  const float* known = W_known_.data() + std::size_t(k) * width();
  for (int i = 0; i < width(); ++i) shifted[i] = base[i] + known[i];
}

void SplitDense::forward(const Kernels& kernels, const float* base, ConstRows A, int n,
                         Rows Y) const noexcept {
  if (n == 1) {
    kernels.gemv(W_action_.packed(), base, A.data, Y.data);
  } else {
    kernels.gemm(W_action_.packed(), {base, 0}, A, n, Y);
  }
  for (int row = 0; row < n; ++row) {
    float* y = Y.data + row * Y.stride;
    for (std::size_t begin = 0; norm_ && begin < std::size_t(width()); begin += padded(out_)) {
      kernels.layer_norm(norm_->scale.data() + begin, norm_->offset.data() + begin, norm_->epsilon,
                         y + begin, out_);
    }
    kernels.activate(activation_, y, width());
  }
}

}  // namespace tandem::policy
