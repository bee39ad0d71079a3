#pragma once

#include <cstddef>
#include <string>

#include "policy_runtime/kernels/kernels.h"

namespace tandem::policy {

class SafetensorsFile;

/// y = act(norm(W x + b)), the norm optional. Weights live in an arena that the policy owns.
struct Dense {
  int in = 0;
  int out = 0;
  bool norm = false;
  Activation activation = Activation::kIdentity;

  PackedMatrix W;                      ///< (out, in)
  const float* b = nullptr;            ///< (out)
  const float* norm_scale = nullptr;   ///< (out), or null without norm
  const float* norm_offset = nullptr;  ///< (out), or null without norm

  Dense(int in, int out, bool norm, Activation activation);

  /// Floats this layer needs in the arena, a multiple of kPadding.
  std::size_t size() const;

  /// Takes PREFIX.weight, .bias and, with norm, .norm_scale and .norm_offset from the file and
  /// packs them to `arena` (size() floats, zero before). Returns the arena's next free float.
  /// @throws PolicyError
  float* load(SafetensorsFile& file, const std::string& prefix, float* arena);

  /// x padded(in), y padded(out), not overlapping. Real-time.
  void forward(const Kernels& kernels, const float* x, float* y) const noexcept;
};

}  // namespace tandem::policy
