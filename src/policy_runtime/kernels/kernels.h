#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
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

/// How weights lie in memory. Arithmetic is float32 in either case.
enum class Precision { kFloat32, kBfloat16 };

/// A matrix (rows, columns) laid out for gemv and gemm: panels of kPadding rows; inside a panel,
/// column after column, the kPadding values of a column side by side. Rows are padded to kPadding
/// and columns to kPhases with zeros.
struct PackedMatrix {
  static constexpr int kPhases =
      4;  ///< columns that gemv sums apart, to hide the latency of the addition

  int rows = 0;
  int columns = 0;
  Precision precision = Precision::kFloat32;
  const float* data = nullptr;  ///< (panels, padded columns, kPadding), 64-byte aligned; kFloat32
  const std::uint16_t* data_bf16 = nullptr;  ///< the same as the upper halves of floats; kBfloat16

  int padded_columns() const { return (columns + kPhases - 1) / kPhases * kPhases; }
  std::size_t count() const { return padded(rows) * padded_columns(); }  ///< numbers behind data
  std::size_t floats() const {  ///< memory behind data, in floats
    return padded(precision == Precision::kFloat32 ? count() : count() / 2);
  }
};

/// Writes matrix.floats() floats to `packed` (zero before) and points the matrix to them. row_major
/// is (rows, columns); for kBfloat16 the lower halves of its numbers are cut off.
void pack(const float* row_major, PackedMatrix& matrix, float* packed);

/// Multi-head attention: n_queries tokens look at n_keys tokens. Head i works on the columns
/// [i head_size, (i + 1) head_size) of every matrix.
struct AttentionShape {
  int n_queries = 0;
  int n_keys = 0;
  int heads = 1;
  int head_size = 0;

  static constexpr int kBlock = 48;  ///< queries at a time, so that their scores stay in the cache

  /// Floats of scratch that attention needs: one head's keys and values in panels, a row of zeros,
  /// scores and results of a block of queries.
  std::size_t scratch() const {
    const std::size_t keys = padded(n_keys), size = padded(head_size);
    return keys * head_size + n_keys * size + std::max(keys, size) +
           std::clamp(n_queries, kPadding, kBlock) * (keys + size);
  }
};

/// Rows of equal length in memory: row i begins at data + i stride.
struct Rows {
  float* data;
  std::size_t stride;  ///< floats
};
struct ConstRows {
  const float* data;
  std::size_t stride;  ///< floats; 0: every row is the same one

  ConstRows(const float* data, std::size_t stride) : data(data), stride(stride) {}
  ConstRows(Rows rows) : data(rows.data), stride(rows.stride) {}  // NOLINT: meant to convert
};

/// A tile of 2 x 2 pixels that winograd_output writes.
struct WinogradOutput {
  int channels = 0;                 ///< a multiple of kPadding
  int height = 2, width = 2;        ///< less where the tile sticks out of the map
  bool relu = false;                ///< y = max(y, 0) at the end
  const float* residual = nullptr;  ///< added before that; null: nothing
  std::size_t residual_row_stride = 0, residual_pixel_stride = 0;
  float* out = nullptr;
  std::size_t out_row_stride = 0, out_pixel_stride = 0;
};

/// One instruction set. None of these allocates, locks or throws.
struct Kernels {
  const char* name;  ///< "scalar", "SSE4", "AVX2", "AVX-512", ...

  /// y = W x + b. Sums are formed in an order that does not depend on the register width:
  /// instruction sets with a fused multiply-add (AVX2, AVX-512, NEON) agree bit for bit. x, b and y
  /// do not overlap.
  void (*gemv)(const PackedMatrix& W, const float* b, const float* x, float* y);

  /// Y = X W' + bias for n rows: X (n, W.columns), bias and Y (n, W.rows), every row padded. Every
  /// sum runs over the columns in order, from the bias on, as in gemv independent of the width, and
  /// of n. A row of X that is not finite makes its own row of Y NaN or infinite, padding included.
  void (*gemm)(const PackedMatrix& W, ConstRows bias, ConstRows X, int n, Rows Y);

  /// y = (y - mean) / sqrt(variance + epsilon) * scale + offset over the first n, biased variance.
  void (*layer_norm)(const float* scale, const float* offset, float epsilon, float* y, int n);

  /// y = f(y) over the first n. gelu is the tanh approximation.
  void (*activate)(Activation f, float* y, int n);

  /// out (n_queries, ·) = softmax(Q K') V, head by head. Q carries the factor 1 / sqrt(head_size)
  /// already. Only the columns of the heads are written. Rows need no alignment here; scratch (64
  /// bytes aligned, any content) does. A number that is not finite never goes unnoticed: it makes
  /// those outputs NaN or infinite that depend on it.
  void (*attention)(const AttentionShape& shape, ConstRows Q, ConstRows K, ConstRows V, Rows out,
                    float* scratch);

  /// Winograd's F(2 x 2, 3 x 3) on the way in, channel by channel: V = B' D B for D, 4 x 4 pixels.
  /// Pixel (y, x) begins at D + y row_stride + x channels, element i of V (16, row by row) at V +
  /// i stride. channels is a multiple of kPadding.
  void (*winograd_input)(const float* D, std::size_t row_stride, int channels, float* V,
                         std::size_t stride);

  /// And on the way out: Y = A' M A, 2 x 2 pixels. Element i of M (16) begins at M + i stride.
  void (*winograd_output)(const float* M, std::size_t stride, const WinogradOutput& tile);
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
