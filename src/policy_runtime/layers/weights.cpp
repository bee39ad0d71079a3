#include "policy_runtime/layers/weights.h"

#include <algorithm>

#include "policy_runtime/file/safetensors.h"

namespace tandem::policy {

WeightMatrix::WeightMatrix(const std::vector<float>& row_major, int rows, int columns,
                           Precision precision)
    : packed_{rows, columns, precision}, buffer_(packed_.floats()) {
  pack(row_major.data(), packed_, buffer_.data());
}

WeightMatrix WeightMatrix::take(SafetensorsFile& file, const std::string& name, int rows,
                                int columns) {
  const std::vector<float> values = file.take(name, {rows, columns});
  return {values, rows, columns,
          file.is_bfloat16(name) ? Precision::kBfloat16 : Precision::kFloat32};
}

AlignedBuffer take_vector(SafetensorsFile& file, const std::string& name, int n) {
  const std::vector<float> values = file.take(name, {n});
  AlignedBuffer buffer(n);
  std::copy(values.begin(), values.end(), buffer.data());
  return buffer;
}

AlignedBuffer take_rows(SafetensorsFile& file, const std::string& name, int rows, int columns) {
  const std::vector<float> values = file.take(name, {rows, columns});
  const std::size_t stride = padded(columns);
  AlignedBuffer buffer(stride * rows);
  for (int row = 0; row < rows; ++row) {
    std::copy_n(values.begin() + std::size_t(row) * columns, columns, buffer.data() + row * stride);
  }
  return buffer;
}

}  // namespace tandem::policy
