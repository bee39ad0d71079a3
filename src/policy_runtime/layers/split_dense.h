#pragma once

#include <optional>
#include <string>
#include <vector>

#include "policy_runtime/layers/dense.h"

namespace tandem::policy {

/// The input [x, a, c] of a layer by how often its parts change.
struct SplitInput {
  int observation = 0;                          ///< numbers of x, the same for a whole forward pass
  int action = 0;                               ///< numbers of a, others in every row
  std::vector<std::vector<double>> known = {};  ///< the values that c takes; empty: there is no c
};

/// The first layers of M networks of one shape over the same input:
///
///   y_m = act(norm(W_m [x, a, c_k] + b_m)),  m = 1..M,
///
/// multiplied part by part, so that each product is made as rarely as its factors change: W c_k at
/// load, base = W x + b once per observation, W a for every row. The matrices of the M networks
/// lie one below the other, so one product serves all; network m owns the numbers
/// [m padded(out), m padded(out) + out) of every result.
class SplitDense {
 public:
  /// Takes PREFIX.weight (out, x + a + c), .bias (out) and, with norm, .norm_scale and .norm_offset
  /// (out) for every prefix. @throws PolicyError
  SplitDense(SafetensorsFile& file, const std::vector<std::string>& prefixes,
             const SplitInput& input, int out, bool norm, Activation activation);

  int width() const noexcept { return W_action_.rows(); }  ///< M padded(out)

  /// base (width) = W x + b. Real-time.
  void observe(const Kernels& kernels, const float* x, float* base) const noexcept;

  /// shifted (width) = base + W c_k. Real-time.
  void shift(const float* base, int k, float* shifted) const noexcept;

  /// A (n, a) -> Y (n, width) = act(norm(W a + base)). Real-time.
  void forward(const Kernels& kernels, const float* base, ConstRows A, int n,
               Rows Y) const noexcept;

 private:
  struct Matrices {
    std::vector<float> observation, action;  // row-major, as in WeightMatrix
    std::vector<float> known;                // (known.size(), width)
    bool bfloat16 = true;
  };
  SplitDense(const Matrices& matrices, SafetensorsFile& file,
             const std::vector<std::string>& prefixes, const SplitInput& input, int out, bool norm,
             Activation activation);
  static Matrices take(SafetensorsFile& file, const std::vector<std::string>& prefixes,
                       const SplitInput& input, int out);

  int out_;
  WeightMatrix W_observation_;  // (width, x)
  WeightMatrix W_action_;       // (width, a)
  std::vector<float> W_known_;  // (known.size(), width): W c_k
  AlignedBuffer b_;             // (width)
  std::optional<LayerNorm> norm_;
  Activation activation_;
};

}  // namespace tandem::policy
