#pragma once

#include <cstddef>
#include <vector>

#include "policy_runtime/kernels/kernels.h"

namespace tandem::policy {

/// The velocity v(x, a, t) of a flow at the times t = k / K. Immutable.
///
/// One evaluation of the flow is observe(), then velocity() for the steps 0..K-1, all with the same
/// workspace and number of samples. Add a new field here and in FlowHead's load_field.
class VelocityField {
 public:
  virtual ~VelocityField() = default;

  /// Floats of scratch for so many samples. They are zero before the first use.
  virtual std::size_t workspace_size(int samples) const noexcept = 0;

  /// Computes what depends on the observation x (O) alone; it stays in the workspace. Real-time.
  virtual void observe(const float* x, float* workspace) const noexcept = 0;

  /// A (samples, h A) -> V (samples, h A), the velocity at t = step / K. Real-time.
  virtual void velocity(int step, ConstRows A, int samples, Rows V,
                        float* workspace) const noexcept = 0;
};

/// phi(t) (n, even) = [cos(pi i t), i = 1..n/2] ++ [sin(pi i t), i = 1..n/2].
std::vector<double> time_features(int n, double t);

}  // namespace tandem::policy
