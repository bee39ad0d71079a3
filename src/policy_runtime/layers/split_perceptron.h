#pragma once

#include <string>
#include <vector>

#include "policy_runtime/layers/perceptron.h"
#include "policy_runtime/layers/split_dense.h"

namespace tandem::policy {

/// M perceptrons of one shape over the same input [x, a, c], whose first layers are one SplitDense:
/// for networks that see one observation together with many actions.
class SplitPerceptron {
 public:
  /// Takes PREFIX.layers.{i}.* for every prefix, as Perceptron does. @throws PolicyError
  SplitPerceptron(SafetensorsFile& file, const std::vector<std::string>& prefixes,
                  const Perceptron::Config& config, const SplitInput& input, int out);

  /// The same base for any number of calls to forward(), see SplitDense.
  const SplitDense& first() const noexcept { return first_; }

  /// Floats of scratch for n rows.
  std::size_t workspace_size(int n) const noexcept;

  /// A (n, a) -> Y (n, M padded(out)): the result of network m begins at column m padded(out).
  /// Real-time.
  void forward(const Kernels& kernels, const float* base, ConstRows A, int n, Rows Y,
               float* workspace) const noexcept;

 private:
  SplitDense first_;
  std::vector<Perceptron> rest_;  // (M), behind the first hidden layer; empty when there is none
  std::size_t hidden_stride_;     // floats between the first hidden layers of two networks
  std::size_t out_stride_;        // floats between the results of two networks
};

}  // namespace tandem::policy
