#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "policy_runtime/kernels/kernels.h"
#include "random_problem.h"

namespace tandem::policy {
namespace {

TEST(Gemm, AgreesWithTheFormulaAtOddSizesAndStrides) {
  std::mt19937 random(11);
  for (const int n : {1, 2, 3, 4, 5, 6, 7, 8, 11, 13, 23, 26}) {
    for (const int columns : {1, 3, 16, 37, 300}) {
      for (const int outputs : {1, 15, 16, 17, 33, 70}) {
        const RandomMatrix matrix(outputs, columns, random,
                                  n % 2 ? Precision::kFloat32 : Precision::kBfloat16);
        RandomRows X(n, columns, n % 3 * kPadding, random);
        RandomRows bias(n, outputs, columns % 2 * kPadding, random);
        for (const std::size_t bias_stride : {std::size_t{0}, bias.stride}) {
          for (const Kernels& kernels : all_kernels()) {
            RandomRows Y(n, outputs, outputs % 2 * kPadding, random);
            kernels.gemm(matrix.W, {bias.memory.data(), bias_stride}, X, n, Y);
            for (int i = 0; i < n; ++i) {
              for (int r = 0; r < outputs; ++r) {
                const float b = bias.memory.data()[i * bias_stride + r];
                ASSERT_NEAR(Y.row(i)[r], matrix.product(r, X.row(i), b), 2e-6 * (columns + 4))
                    << kernels.name << " row " << i << " of " << n << ", output " << r << " of "
                    << outputs << ", " << columns << " columns";
              }
            }
            Y.expect_gaps_untouched();
          }
        }
      }
    }
  }
}

// What makes a candidate's action independent of how many others are computed with it, and logs of
// two machines comparable bit for bit. The sizes exceed the blocks of rows and of columns.
TEST(Gemm, SumsInOrderWhateverTheNumberOfRowsAndTheRegisterWidth) {
  std::mt19937 random(12);
  const int n = 131, columns = 601, outputs = 67;
  const RandomMatrix matrix(outputs, columns, random);
  RandomRows X(n, columns, 0, random), bias(n, outputs, 0, random);
  for (const Kernels& kernels : all_kernels()) {
    RandomRows all(n, outputs, 0, random);
    kernels.gemm(matrix.W, bias, X, n, all);
    for (int i = 0; i < n; ++i) {
      for (int r = 0; r < outputs; r += 11) {
        float sum = bias.row(i)[r];
        for (int c = 0; c < columns; ++c) {
          const float w = matrix.row(r)[c], x = X.row(i)[c];
          sum = fused(kernels) ? std::fma(w, x, sum) : sum + w * x;
        }
        ASSERT_EQ(all.row(i)[r], sum) << kernels.name << " row " << i << ", output " << r;
      }
    }
    for (int some = 1; some <= 30; ++some) {
      const int first = n - some;
      RandomRows Y(some, outputs, 0, random);
      kernels.gemm(matrix.W, {bias.row(first), bias.stride}, {X.row(first), X.stride}, some, Y);
      for (int i = 0; i < some; ++i) {
        for (int r = 0; r < outputs; ++r) {
          ASSERT_EQ(Y.row(i)[r], all.row(first + i)[r])
              << kernels.name << " row " << i << " of " << some << ", output " << r;
        }
      }
    }
  }
}

TEST(Gemm, BfloatWeightsComputeAsTheFloatsThatTheyStandFor) {
  std::mt19937 random(13);
  const RandomMatrix half(50, 301, random, Precision::kBfloat16);
  PackedMatrix same{50, 301};
  AlignedBuffer packed(same.floats());
  pack(half.row_major.data(), same, packed.data());
  RandomRows X(9, 301, 0, random), bias(9, 50, 0, random);
  for (const Kernels& kernels : all_kernels()) {
    RandomRows expected(9, 50, 0, random), Y(9, 50, 0, random);
    kernels.gemm(same, bias, X, 9, expected);
    kernels.gemm(half.W, bias, X, 9, Y);
    for (int i = 0; i < 9; ++i) {
      for (int r = 0; r < 50; ++r) ASSERT_EQ(Y.row(i)[r], expected.row(i)[r]) << kernels.name;
    }
    kernels.gemv(same, bias.row(0), X.row(0), expected.row(0));
    kernels.gemv(half.W, bias.row(0), X.row(0), Y.row(0));
    for (int r = 0; r < 50; ++r) ASSERT_EQ(Y.row(0)[r], expected.row(0)[r]) << kernels.name;
    Y.expect_gaps_untouched();
  }
}

TEST(Gemm, OfNoRowsWritesNothing) {
  std::mt19937 random(15);
  const RandomMatrix matrix(20, 40, random);
  RandomRows X(1, 40, 0, random), bias(1, 20, 0, random), Y(1, 20, 0, random);
  const float before = Y.row(0)[0];
  for (const Kernels& kernels : all_kernels()) {
    kernels.gemm(matrix.W, bias, X, 0, Y);
    ASSERT_EQ(Y.row(0)[0], before) << kernels.name;
  }
}

TEST(Gemm, KeepsABadRowToItself) {
  std::mt19937 random(14);
  const int n = 15, columns = 40, outputs = 20;
  const RandomMatrix matrix(outputs, columns, random);
  RandomRows X(n, columns, 0, random), bias(n, outputs, 0, random);
  X.row(3)[7] = std::numeric_limits<float>::quiet_NaN();
  X.row(8)[0] = std::numeric_limits<float>::infinity();
  for (const Kernels& kernels : all_kernels()) {
    RandomRows Y(n, outputs, 0, random);
    kernels.gemm(matrix.W, bias, X, n, Y);
    for (int i = 0; i < n; ++i) {
      for (int r = 0; r < outputs; ++r) {
        ASSERT_EQ(std::isfinite(Y.row(i)[r]), i != 3 && i != 8) << kernels.name << " row " << i;
      }
    }
  }
}

}  // namespace
}  // namespace tandem::policy
