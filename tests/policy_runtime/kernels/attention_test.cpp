#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "policy_runtime/kernels/kernels.h"
#include "random_problem.h"

namespace tandem::policy {
namespace {

struct Problem {
  AttentionShape shape;
  RandomRows Q, K, V, out;
  AlignedBuffer scratch;

  /// `gap` floats between rows, which kernels must not touch.
  Problem(AttentionShape shape, int gap, std::mt19937& random)
      : shape(shape),
        Q(shape.n_queries, width(), gap, random),
        K(shape.n_keys, width(), 2 * gap, random),
        V(shape.n_keys, width(), gap, random),
        out(shape.n_queries, width(), gap, random),
        scratch(shape.scratch()) {}

  int width() const { return shape.heads * shape.head_size; }

  /// In a scratch full of NaN with nothing of it beyond its end.
  void run(const Kernels& kernels) {
    std::fill_n(scratch.data(), scratch.size(), std::numeric_limits<float>::quiet_NaN());
    kernels.attention(shape, Q, K, V, out, scratch.data());
  }

  /// Output (query, column) in double precision.
  double expected(int query, int column) {
    const int begin = column / shape.head_size * shape.head_size;
    std::vector<double> scores(shape.n_keys);
    for (int j = 0; j < shape.n_keys; ++j) {
      for (int c = begin; c < begin + shape.head_size; ++c) {
        scores[j] += double{Q.row(query)[c]} * K.row(j)[c];
      }
    }
    const double largest = *std::max_element(scores.begin(), scores.end());
    double sum = 0.0, total = 0.0;
    for (int j = 0; j < shape.n_keys; ++j) {
      const double weight = std::exp(scores[j] - largest);
      total += weight;
      sum += weight * V.row(j)[column];
    }
    return sum / total;
  }
};

TEST(Attention, AgreesWithTheFormulaAtOddSizesAndStrides) {
  std::mt19937 random(21);
  const AttentionShape shapes[] = {{1, 1, 1, 1},    {1, 17, 3, 5},    {3, 2, 2, 16},
                                   {7, 16, 1, 64},  {8, 15, 4, 10},   {16, 3, 4, 32},
                                   {13, 33, 2, 17}, {49, 200, 1, 33}, {1, 50, 2, 64},
                                   {100, 31, 1, 8}, {5, 9, 1, 128},   {97, 65, 2, 7}};
  for (const AttentionShape& shape : shapes) {
    for (const int gap : {0, 16}) {
      Problem p(shape, gap, random);
      const float factor = 1.0f / std::sqrt(float(shape.head_size));
      for (int i = 0; i < shape.n_queries; ++i) {
        for (int c = 0; c < p.width(); ++c) p.Q.row(i)[c] *= factor;
      }
      for (const Kernels& kernels : all_kernels()) {
        p.run(kernels);
        for (int i = 0; i < shape.n_queries; ++i) {
          for (int c = 0; c < p.width(); ++c) {
            ASSERT_NEAR(p.out.row(i)[c], p.expected(i, c), 3e-6)
                << kernels.name << " query " << i << ", column " << c << ": " << shape.n_queries
                << " x " << shape.n_keys << ", " << shape.heads << " heads of " << shape.head_size;
          }
        }
        p.out.expect_gaps_untouched();
      }
    }
  }
}

// A softmax that forgets to subtract the largest score gives NaN from 89 on.
TEST(Attention, StandsScoresThatWouldOverflowTheExponential) {
  std::mt19937 random(22);
  Problem p({4, 19, 1, 8}, 0, random);
  for (int i = 0; i < 4; ++i) {
    for (int c = 0; c < 8; ++c) p.Q.row(i)[c] *= 500.0f;
  }
  for (const Kernels& kernels : all_kernels()) {
    p.run(kernels);
    for (int i = 0; i < 4; ++i) {
      for (int c = 0; c < 8; ++c) {
        ASSERT_NEAR(p.out.row(i)[c], p.expected(i, c), 5e-4) << kernels.name;  // scores of +-5000
      }
    }
  }
}

TEST(Attention, IgnoresAKeyOfMinusInfinity) {
  std::mt19937 random(23);
  Problem p({3, 18, 1, 4}, 0, random);
  for (int i = 0; i < 3; ++i) p.Q.row(i)[0] = 1.0f;
  p.K.row(5)[0] = -std::numeric_limits<float>::infinity();
  for (const Kernels& kernels : all_kernels()) {
    p.run(kernels);
    for (int i = 0; i < 3; ++i) {
      for (int c = 0; c < 4; ++c) ASSERT_NEAR(p.out.row(i)[c], p.expected(i, c), 1e-6);
    }
  }
}

TEST(Attention, LetsNoNanPassUnnoticed) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  std::mt19937 random(24);
  for (const Kernels& kernels : all_kernels()) {
    Problem p({7, 18, 2, 5}, 0, random);
    p.Q.row(2)[6] = nan;  // second head of one query
    p.run(kernels);
    for (int i = 0; i < 7; ++i) {
      for (int c = 0; c < 10; ++c) {
        ASSERT_EQ(std::isnan(p.out.row(i)[c]), i == 2 && c >= 5) << kernels.name;
      }
    }
    p.Q.row(2)[6] = 0.0f;
    p.K.row(17)[1] = nan;  // the first head of every query
    p.run(kernels);
    for (int i = 0; i < 7; ++i) {
      for (int c = 0; c < 10; ++c) ASSERT_EQ(std::isnan(p.out.row(i)[c]), c < 5) << kernels.name;
    }
  }
}

// As for gemm: how many queries go together, and whether the machine has AVX-512, changes no bit.
TEST(Attention, GivesAQueryTheSameBitsInAnyCompany) {
  std::mt19937 random(25);
  Problem all({101, 39, 2, 12}, 0, random);
  for (const Kernels& kernels : all_kernels()) {
    all.run(kernels);
    for (const int n : {1, 2, 5, 8, 13, 31, 50}) {
      Problem some({n, 39, 2, 12}, 0, random);
      kernels.attention(some.shape, {all.Q.row(101 - n), all.Q.stride}, all.K, all.V, some.out,
                        some.scratch.data());
      for (int i = 0; i < n; ++i) {
        for (int c = 0; c < 24; ++c) {
          ASSERT_EQ(some.out.row(i)[c], all.out.row(101 - n + i)[c]) << kernels.name;
        }
      }
    }
  }
}

}  // namespace
}  // namespace tandem::policy
