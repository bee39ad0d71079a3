#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "policy_runtime/aligned_buffer.h"

/// The arithmetic. Every kernel exists as a plain scalar reference and, through Highway, once per
/// instruction set; one set is chosen at start. All vectors are AlignedBuffer slices padded to
/// kPadding; padding is zero before and after.
namespace tandem::policy {

enum class Activation { kIdentity, kRelu, kTanh, kGelu };

/// "identity", "relu", "tanh" or "gelu"; false for any other name.
bool activation_from_name(std::string_view name, Activation& activation);

/// A matrix (rows, columns) laid out for gemv: panels of kPadding rows; inside a panel, column
/// after column, the kPadding values of a column side by side. Rows are padded to kPadding and
/// columns to kPhases with zeros.
struct PackedMatrix {
  static constexpr int kPhases =
      4;  ///< columns that are summed apart, to hide the latency of the addition

  const float* data = nullptr;  ///< (panels, padded columns, kPadding), 64-byte aligned
  int rows = 0;
  int columns = 0;

  int padded_columns() const { return (columns + kPhases - 1) / kPhases * kPhases; }
  std::size_t size() const { return padded(rows) * padded_columns(); }  ///< floats behind data
};

/// Writes matrix.size() floats to `packed` (zero before) and points the matrix to them. row_major
/// is (rows, columns).
void pack(const float* row_major, PackedMatrix& matrix, float* packed);

/// One instruction set. None of these allocates, locks or throws.
struct Kernels {
  const char* name;  ///< "scalar", "SSE4", "AVX2", "AVX-512", ...

  /// y = W x + b. Sums are formed in an order that does not depend on the register width:
  /// instruction sets with a fused multiply-add (AVX2, AVX-512, NEON) agree bit for bit. x, b and y
  /// do not overlap.
  void (*gemv)(const PackedMatrix& W, const float* b, const float* x, float* y);

  /// y = (y - mean) / sqrt(variance + 1e-6) * scale + offset over the first n, biased variance.
  void (*layer_norm)(const float* scale, const float* offset, float* y, int n);

  /// y = f(y) over the first n. gelu is the tanh approximation.
  void (*activate)(Activation f, float* y, int n);
};

/// The set in use: TANDEM_KERNEL if it is set, else the best of this machine. Cheap, lock-free
/// after the first call.
/// @throws PolicyError on the first call when TANDEM_KERNEL names none of available_kernels().
const Kernels& kernels();

/// Name of the set in use, for prints and logs. @throws as kernels()
std::string kernel_name();

/// Names that this machine can run, best first, "scalar" last.
std::vector<std::string> available_kernels();

/// From now on use this set: one of available_kernels() (case ignored) or "simd" for the best of
/// them that is not scalar. Not to be called while a run that must be reproducible is under way.
/// @throws PolicyError
void force_kernel(std::string_view name);

const Kernels& scalar_kernels();             ///< the reference; slow and obvious
const std::vector<Kernels>& simd_kernels();  ///< best first; empty on a machine without any

}  // namespace tandem::policy
