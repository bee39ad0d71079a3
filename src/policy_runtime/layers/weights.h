#pragma once

#include <string>
#include <vector>

#include "policy_runtime/kernels/kernels.h"

namespace tandem::policy {

class SafetensorsFile;

/// A matrix (rows, columns) of a policy, packed for the kernels. Keeps its memory.
class WeightMatrix {
 public:
  /// @param row_major (rows, columns)
  WeightMatrix(const std::vector<float>& row_major, int rows, int columns, Precision precision);

  /// The tensor NAME (rows, columns), in the precision of the file. @throws PolicyError
  static WeightMatrix take(SafetensorsFile& file, const std::string& name, int rows, int columns);

  const PackedMatrix& packed() const noexcept { return packed_; }
  int rows() const noexcept { return packed_.rows; }
  int columns() const noexcept { return packed_.columns; }

 private:
  PackedMatrix packed_;
  AlignedBuffer buffer_;
};

/// The tensor NAME (n), padded with zeros. @throws PolicyError
AlignedBuffer take_vector(SafetensorsFile& file, const std::string& name, int n);

/// The tensor NAME (rows, columns), each row padded with zeros: row stride padded(columns).
/// @throws PolicyError
AlignedBuffer take_rows(SafetensorsFile& file, const std::string& name, int rows, int columns);

}  // namespace tandem::policy
