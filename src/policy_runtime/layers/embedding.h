#pragma once

#include <vector>

#include "policy_runtime/layers/projection.h"

namespace tandem::policy {

/// What the first layer of a transformer begins with, straight from the numbers v that a token is
/// made of. The token is x = E v + e and the layer asks for W x + b; both maps are linear, so
///
///   [x | W x + b] = [E; W E] v + [e | W e + b]
///
/// is one small product, and the layer's own W is never read.
class Embedding {
 public:
  /// A row [x | W x + b]: x (d) padded with zeros, then the projection's outputs, padded. Without
  /// projection (null) a row is x alone.
  static std::size_t width(int d, const Projection* projection) noexcept {
    return padded(d) + (projection ? padded(projection->out()) : 0);
  }

  /// Such rows for x_i without b: what n things that are added to a token add to its row. For the
  /// loader.
  /// @param X (n, d)
  static AlignedBuffer rows(ConstRows X, int n, int d, const Projection* projection);

  /// @param E (d, in), row-major
  /// @param e (n, d): tokens i, i + n, i + 2 n, ... have the row i
  /// @param projection null: none
  /// @param first position of token 0 in the projection
  Embedding(const std::vector<float>& E, int d, int in, ConstRows e, int n,
            const Projection* projection, int first);

  int in() const noexcept { return matrix_.columns(); }

  /// V (samples n, in) -> rows Y (samples n, ·). Real-time.
  void forward(const Kernels& kernels, ConstRows V, int samples, Rows Y) const noexcept;

  /// The row of the first token when v is zeros.
  const float* of_zeros() const noexcept { return bias_.data(); }

 private:
  static WeightMatrix compose(const std::vector<float>& E, int d, int in,
                              const Projection* projection);
  static AlignedBuffer offsets(ConstRows e, int n, int d, const Projection* projection, int first);

  int n_;
  WeightMatrix matrix_;  // (width, in)
  AlignedBuffer bias_;   // (n, width)
};

}  // namespace tandem::policy
