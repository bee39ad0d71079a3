#pragma once

#include <string>
#include <vector>

#include "policy_runtime/layers/weights.h"

namespace tandem::policy {

/// Several linear maps of the same input as one gemm: y = [W_1; W_2; ...] x + [b_1; b_2; ...].
///
/// Positions that a transformer adds to its input are known when the policy is loaded, and
/// W (x + p) + b = W x + (W p + b): they become bias rows and cost nothing in forward().
class Projection {
 public:
  /// Takes PREFIX.weight (out, in) and PREFIX.bias (out) of every prefix. The outputs of the first
  /// are multiplied by `factor`: in the weights, unless they are bfloat16 and would be rounded.
  /// @throws PolicyError
  Projection(SafetensorsFile& file, const std::vector<std::string>& prefixes, int in, int out,
             float factor = 1.0f);

  /// From now on row i of an input is meant as x_i + p_i by the first `parts` maps, and as x_i by
  /// the others. Slow, for the loader.
  /// @param positions (n, in)
  void add_positions(ConstRows positions, int n, int parts);

  int in() const noexcept { return W_.columns(); }
  int out() const noexcept { return W_.rows(); }  ///< of all maps together

  /// X (n, in) -> Y (n, out), row strides padded. The first row of X has the position `first`.
  /// Real-time.
  void forward(const Kernels& kernels, ConstRows X, int n, Rows Y, int first = 0) const noexcept;

  /// The same without bias and positions. Real-time.
  void multiply(const Kernels& kernels, ConstRows X, int n, Rows Y) const noexcept;

 private:
  void multiply(const Kernels& kernels, ConstRows bias, ConstRows X, int n, Rows Y) const noexcept;

  int part_;                     // outputs of one map
  float factor_ = 1.0f;          // of the first map's outputs, where W_ and bias_ do not hold it
  WeightMatrix W_;               // (parts part, in)
  AlignedBuffer bias_;           // (parts part), or one such row per position
  std::size_t bias_stride_ = 0;  // floats; 0 = no positions
  AlignedBuffer zero_;           // (parts part)
};

}  // namespace tandem::policy
