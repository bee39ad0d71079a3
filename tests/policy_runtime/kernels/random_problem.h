#pragma once

#include <gtest/gtest.h>

#include <cstring>
#include <random>
#include <string>
#include <vector>

#include "policy_runtime/kernels/kernels.h"

/// Random matrices and vectors for tests of kernels, and what all of those tests look at.
namespace tandem::policy {

inline std::vector<Kernels> all_kernels() {
  std::vector<Kernels> all = simd_kernels();
  all.push_back(scalar_kernels());
  return all;
}

/// These instruction sets have a fused multiply-add; they must agree bit for bit.
inline bool fused(const Kernels& kernels) {
  const std::string name = kernels.name;
  return name == "AVX2" || name == "AVX-512" || name == "NEON";
}

/// n numbers, then zeros up to the padding.
inline AlignedBuffer random_vector(int n, std::mt19937& random, float deviation = 1.0f) {
  std::normal_distribution<float> normal(0.0f, deviation);
  AlignedBuffer buffer(n);
  for (int i = 0; i < n; ++i) buffer.data()[i] = normal(random);
  return buffer;
}

inline void expect_padding_zero(const AlignedBuffer& y, int n) {
  for (std::size_t i = n; i < y.size(); ++i) ASSERT_EQ(y.data()[i], 0.0f) << "padding " << i;
}

/// n rows of `columns` numbers, padded with zeros; `gap` floats of 99 between two rows.
struct RandomRows {
  int n, columns;
  std::size_t stride;
  AlignedBuffer memory;

  RandomRows(int n, int columns, int gap, std::mt19937& random)
      : n(n), columns(columns), stride(padded(columns) + gap), memory(n * stride) {
    std::normal_distribution<float> normal;
    for (int i = 0; i < n; ++i) {
      for (int c = 0; c < columns; ++c) row(i)[c] = normal(random);
      for (std::size_t c = padded(columns); c < stride; ++c) row(i)[c] = 99.0f;
    }
  }

  float* row(int i) { return memory.data() + i * stride; }
  operator Rows() { return {memory.data(), stride}; }             // NOLINT: meant to convert
  operator ConstRows() const { return {memory.data(), stride}; }  // NOLINT
  void expect_gaps_untouched() {
    for (int i = 0; i < n; ++i) {
      for (std::size_t c = columns; c < padded(columns); ++c) ASSERT_EQ(row(i)[c], 0.0f);
      for (std::size_t c = padded(columns); c < stride; ++c) ASSERT_EQ(row(i)[c], 99.0f);
    }
  }
};

/// A packed matrix, and the same numbers row after row.
struct RandomMatrix {
  PackedMatrix W;
  std::vector<float> row_major;  ///< bfloat16 numbers when the matrix is of those
  AlignedBuffer packed;

  RandomMatrix(int rows, int columns, std::mt19937& random,
               Precision precision = Precision::kFloat32)
      : W{rows, columns, precision}, row_major(std::size_t(rows) * columns), packed(W.floats()) {
    std::normal_distribution<float> normal;
    for (float& weight : row_major) {
      weight = normal(random);
      if (precision == Precision::kFloat32) continue;
      std::uint32_t bits;
      std::memcpy(&bits, &weight, sizeof bits);
      bits &= 0xFFFF0000u;
      std::memcpy(&weight, &bits, sizeof bits);
    }
    pack(row_major.data(), W, packed.data());
  }

  const float* row(int r) const { return row_major.data() + std::size_t(r) * W.columns; }

  /// Row r times x plus b, in double precision.
  double product(int r, const float* x, float b) const {
    double sum = b;
    for (int c = 0; c < W.columns; ++c) sum += double{row(r)[c]} * x[c];
    return sum;
  }
};

}  // namespace tandem::policy
