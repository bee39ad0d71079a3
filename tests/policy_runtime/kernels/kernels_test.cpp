#include "policy_runtime/kernels/kernels.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <random>

#include "policy_runtime/policy_error.h"
#include "random_problem.h"

namespace tandem::policy {
namespace {

const int kSizes[] = {1, 2, 3, 4, 5, 7, 8, 15, 16, 17, 31, 33, 63, 64, 100, 129, 257};

TEST(Gemv, AgreesWithTheFormulaAtEverySize) {
  std::mt19937 random(1);
  for (const int rows : kSizes) {
    for (const int columns : kSizes) {
      const RandomMatrix matrix(rows, columns, random);
      const AlignedBuffer b = random_vector(rows, random), x = random_vector(columns, random);
      AlignedBuffer y(rows);
      for (const Kernels& kernels : all_kernels()) {
        std::fill_n(y.data(), y.size(), 99.0f);
        kernels.gemv(matrix.W, b.data(), x.data(), y.data());
        for (int r = 0; r < rows; ++r) {
          const double expected = matrix.product(r, x.data(), b.data()[r]);
          ASSERT_NEAR(y.data()[r], expected, 2e-6 * (columns + 4))
              << kernels.name << " " << rows << " x " << columns << " row " << r;
        }
        expect_padding_zero(y, rows);
      }
    }
  }
}

// What lets logs of an AVX2 and an AVX-512 machine compare bit for bit.
TEST(Gemv, SumsInAnOrderThatDoesNotDependOnTheRegisterWidth) {
  std::mt19937 random(2);
  const RandomMatrix matrix(85, 131, random);
  const AlignedBuffer b = random_vector(85, random), x = random_vector(131, random);
  AlignedBuffer y(85);
  for (const Kernels& kernels : simd_kernels()) {
    kernels.gemv(matrix.W, b.data(), x.data(), y.data());
    for (int r = 0; r < matrix.W.rows; ++r) {
      float sum[4] = {b.data()[r], 0.0f, 0.0f, 0.0f};
      for (int c = 0; c < matrix.W.columns; ++c) {
        const float w = matrix.row(r)[c], v = x.data()[c];
        sum[c % 4] = fused(kernels) ? std::fma(w, v, sum[c % 4]) : sum[c % 4] + w * v;
      }
      ASSERT_EQ(y.data()[r], (sum[0] + sum[1]) + (sum[2] + sum[3])) << kernels.name << " row " << r;
    }
  }
}

TEST(LayerNorm, AgreesWithScalarAtEverySize) {
  std::mt19937 random(3);
  for (const Kernels& kernels : simd_kernels()) {
    for (const int n : kSizes) {
      const AlignedBuffer scale = random_vector(n, random), offset = random_vector(n, random);
      AlignedBuffer y = random_vector(n, random, 3.0f), expected(n);
      std::memcpy(expected.data(), y.data(), n * sizeof(float));
      kernels.layer_norm(scale.data(), offset.data(), 1e-6f, y.data(), n);
      scalar_kernels().layer_norm(scale.data(), offset.data(), 1e-6f, expected.data(), n);
      for (int i = 0; i < n; ++i)
        ASSERT_NEAR(y.data()[i], expected.data()[i], 5e-6) << kernels.name << " " << n;
      expect_padding_zero(y, n);
    }
  }
}

TEST(LayerNorm, HasZeroMeanAndUnitBiasedVariance) {
  std::mt19937 random(4);
  const int n = 50;
  AlignedBuffer scale(n), offset(n), y = random_vector(n, random, 5.0f);
  std::fill_n(scale.data(), n, 1.0f);
  kernels().layer_norm(scale.data(), offset.data(), 1e-6f, y.data(), n);
  double mean = 0, square = 0;
  for (int i = 0; i < n; ++i) {
    mean += y.data()[i] / n;
    square += double{y.data()[i]} * y.data()[i] / n;
  }
  EXPECT_NEAR(mean, 0.0, 1e-6);
  EXPECT_NEAR(square, 1.0, 1e-5);
}

TEST(Activation, AgreesWithDoublePrecisionOverTheWholeRange) {
  const int n = 2001;
  for (const Kernels& kernels : all_kernels()) {
    for (const Activation f :
         {Activation::kIdentity, Activation::kRelu, Activation::kTanh, Activation::kGelu}) {
      AlignedBuffer y(n);
      for (int i = 0; i < n; ++i) y.data()[i] = (i - 1000) * 0.02f;
      const std::vector<float> x(y.data(), y.data() + n);
      kernels.activate(f, y.data(), n);
      for (int i = 0; i < n; ++i) {
        const double v = x[i];
        double expected = v;
        if (f == Activation::kRelu) expected = v > 0 ? v : 0;
        if (f == Activation::kTanh) expected = std::tanh(v);
        if (f == Activation::kGelu) {
          expected = 0.5 * v * (1 + std::tanh(std::sqrt(2 / M_PI) * (v + 0.044715 * v * v * v)));
        }
        ASSERT_NEAR(y.data()[i], expected, 1e-6 * std::fmax(1.0, std::fabs(v)))
            << kernels.name << " at " << v;
      }
      expect_padding_zero(y, n);
    }
  }
}

TEST(Activation, TanhNeverLeavesTheUnitInterval) {
  const float extreme[] = {-3e38f, -100.0f, -9.5f, 9.5f, 44.0f, 45.0f, 100.0f, 3e38f};
  for (const Kernels& kernels : simd_kernels()) {
    AlignedBuffer y(8);
    std::copy_n(extreme, 8, y.data());
    kernels.activate(Activation::kTanh, y.data(), 8);
    for (int i = 0; i < 8; ++i)
      EXPECT_NEAR(y.data()[i], extreme[i] < 0 ? -1.0f : 1.0f, 1e-6) << extreme[i];
    for (int i = 0; i < 8; ++i) EXPECT_LE(std::fabs(y.data()[i]), 1.0f);
  }
}

TEST(Activation, LetsNumbersThatAreNoneThrough) {
  std::vector<Kernels> all = simd_kernels();
  all.push_back(scalar_kernels());
  for (const Kernels& kernels : all) {
    for (const Activation f :
         {Activation::kIdentity, Activation::kRelu, Activation::kTanh, Activation::kGelu}) {
      AlignedBuffer y(3);
      y.data()[1] = std::nanf("");
      kernels.activate(f, y.data(), 3);
      EXPECT_TRUE(std::isnan(y.data()[1])) << kernels.name << ": overflow must not come out as 0";
    }
  }
}

TEST(KernelChoice, CanBeForcedAndNamesTheChoicesOtherwise) {
  for (const std::string& name : available_kernels()) {
    force_kernel(name);
    EXPECT_EQ(kernel_name(), name);
  }
  force_kernel("SCALAR");
  EXPECT_EQ(kernel_name(), "scalar");
  try {
    force_kernel("avx9");
    FAIL() << "an unknown kernel was accepted";
  } catch (const PolicyError& error) {
    EXPECT_NE(std::string(error.what()).find("avx9"), std::string::npos);
    EXPECT_NE(std::string(error.what()).find("scalar"), std::string::npos);
  }
  EXPECT_EQ(kernel_name(), "scalar") << "a refused name must change nothing";
  force_kernel(available_kernels().front());
}

}  // namespace
}  // namespace tandem::policy
