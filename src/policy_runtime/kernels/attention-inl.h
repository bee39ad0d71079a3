// Attention, one head after the other: its keys and values are laid out as panels, so that both
// products are gemm. A few keys would fill a panel badly; there the queries are laid out as one.
#if defined(TANDEM_POLICY_KERNELS_ATTENTION_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef TANDEM_POLICY_KERNELS_ATTENTION_INL_H_
#undef TANDEM_POLICY_KERNELS_ATTENTION_INL_H_
#else
#define TANDEM_POLICY_KERNELS_ATTENTION_INL_H_
#endif

#include <hwy/contrib/math/math-inl.h>

#include <algorithm>
#include <limits>

#include "policy_runtime/kernels/gemm-inl.h"
#include "policy_runtime/kernels/vector-inl.h"

HWY_BEFORE_NAMESPACE();
namespace tandem::policy {
namespace HWY_NAMESPACE {

// Columns [0, 4) of four keys to the same four lanes of four columns of a panel.
HWY_INLINE void TransposeFour(const float* const (&keys)[4], float* panel) {
  constexpr hn::Full128<float> four;
  const auto k0 = hn::LoadU(four, keys[0]), k1 = hn::LoadU(four, keys[1]);
  const auto k2 = hn::LoadU(four, keys[2]), k3 = hn::LoadU(four, keys[3]);
  const auto even01 = hn::InterleaveLower(four, k0, k2), odd01 = hn::InterleaveLower(four, k1, k3);
  const auto even23 = hn::InterleaveUpper(four, k0, k2), odd23 = hn::InterleaveUpper(four, k1, k3);
  hn::Store(hn::InterleaveLower(four, even01, odd01), four, panel);
  hn::Store(hn::InterleaveUpper(four, even01, odd01), four, panel + kPadding);
  hn::Store(hn::InterleaveLower(four, even23, odd23), four, panel + 2 * kPadding);
  hn::Store(hn::InterleaveUpper(four, even23, odd23), four, panel + 3 * kPadding);
}

// n rows of `size` columns as a packed matrix: of keys, scores = q K'.
void PackRows(ConstRows K, int n, int size, float* panels) {
  for (int first = 0; first < n; first += kPadding, panels += size * kPadding) {
    for (int lane = 0; lane < kPadding; lane += 4) {
      const float* keys[4];
      for (int i = 0; i < 4; ++i) {
        keys[i] = part(K, std::min(first + lane + i, n - 1)).data;  // past the end: any will do
      }
      int c = 0;
      for (; c + 4 <= size; c += 4) {
        TransposeFour({keys[0] + c, keys[1] + c, keys[2] + c, keys[3] + c},
                      panels + c * kPadding + lane);
      }
      for (; c < size; ++c) {
        for (int i = 0; i < 4; ++i) panels[c * kPadding + lane + i] = keys[i][c];
      }
    }
  }
}

// V (n, size) as the packed matrix V' (size, n): output = p V.
void PackValues(ConstRows V, int n, int size, float* panels) {
  for (int first = 0; first < size; first += kPadding) {
    const int width = std::min(kPadding, size - first);
    for (int j = 0; j < n; ++j, panels += kPadding) {
      const float* value = part(V, j, first).data;
      if (width == kPadding) {
        for (int lane = 0; lane < kPadding; lane += kLanes) {
          hn::Store(hn::LoadU(d, value + lane), d, panels + lane);
        }
      } else {
        std::fill(std::copy_n(value, width, panels), panels + kPadding, 0.0f);
      }
    }
  }
}

// Highway's own makes 0 of NaN.
HWY_INLINE V Exp(V x) { return hn::IfThenElse(hn::IsNaN(x), x, hn::Exp(d, x)); }

// scores = exp(scores - the largest) over the first n, zero up to the padding. Returns their sum.
float ExpAndSum(float* scores, int n) {
  const int end = static_cast<int>(padded(n));
  std::fill(scores + n, scores + end, -std::numeric_limits<float>::infinity());
  V largest = hn::Load(d, scores);
  for (int i = kLanes; i < end; i += kLanes) largest = hn::Max(largest, hn::Load(d, scores + i));
  largest = hn::MaxOfLanes(d, largest);
  V sum[kRegisters];
  for (V& each : sum) each = hn::Zero(d);
  for (int i = 0; i < end; i += kPadding) {
    HWY_UNROLL(4)
    for (int r = 0; r < kRegisters; ++r) {
      float* at = scores + i + r * kLanes;
      const V weight = Exp(hn::Sub(hn::Load(d, at), largest));
      hn::Store(weight, d, at);
      sum[r] = hn::Add(sum[r], weight);
    }
  }
  return SumOfLanes(sum);
}

// to = from / total
void Divide(const float* from, float total, int size, float* to) {
  int c = 0;
  for (; c + kLanes <= size; c += kLanes) {
    hn::StoreU(hn::Div(hn::Load(d, from + c), hn::Set(d, total)), d, to + c);
  }
  for (; c < size; ++c) to[c] = from[c] / total;
}

// scores (n_keys, kPadding) = exp(scores - the largest of the query), totals (kPadding) their sums.
void ExpAndSumOfColumns(float* scores, int n_keys, float* totals) {
  for (int lane = 0; lane < kPadding; lane += kLanes) {
    V largest = hn::Load(d, scores + lane);
    for (int j = 1; j < n_keys; ++j) {
      largest = hn::Max(largest, hn::Load(d, scores + j * kPadding + lane));
    }
    V total = hn::Zero(d);
    for (int j = 0; j < n_keys; ++j) {
      float* at = scores + j * kPadding + lane;
      const V weight = Exp(hn::Sub(hn::Load(d, at), largest));
      hn::Store(weight, d, at);
      total = hn::Add(total, weight);
    }
    hn::Store(total, d, totals + lane);
  }
}

// With few keys: kPadding queries side by side.
constexpr int kFewKeys = 8;

void AttendToFew(const AttentionShape& shape, ConstRows Q, ConstRows K, ConstRows V, Rows out,
                 float* scratch) {
  const int size = shape.head_size, n_keys = shape.n_keys;
  float* queries = scratch;
  float* values = queries + kPadding * size;
  float* totals = values + n_keys * padded(size);
  float* scores = totals + kPadding;
  float* result = scores + kFewKeys * kPadding;
  for (int head = 0; head < shape.heads; ++head) {
    const int begin = head * size;
    PackValues(part(V, 0, begin), n_keys, size, values);
    for (int first = 0; first < shape.n_queries; first += kPadding) {
      const int n = std::min(kPadding, shape.n_queries - first);
      PackRows(part(Q, first, begin), n, size, queries);
      for (int j = 0; j < n_keys; ++j) {
        const float* key = part(K, j, begin).data;
        HWY_NAMESPACE::V sum[kRegisters];
        for (auto& each : sum) each = hn::Zero(d);
        for (int c = 0; c < size; ++c) {
          const auto value = hn::Set(d, key[c]);
          HWY_UNROLL(4)
          for (int r = 0; r < kRegisters; ++r) {
            sum[r] = hn::MulAdd(hn::Load(d, queries + c * kPadding + r * kLanes), value, sum[r]);
          }
        }
        for (int r = 0; r < kRegisters; ++r) {
          hn::Store(sum[r], d, scores + j * kPadding + r * kLanes);
        }
      }
      ExpAndSumOfColumns(scores, n_keys, totals);
      for (int i = 0; i < n; ++i) {
        for (int c = 0; c < size; c += kLanes) {
          const float* value = values + c / kPadding * n_keys * kPadding + c % kPadding;
          auto sum = hn::Zero(d);
          for (int j = 0; j < n_keys; ++j) {
            const auto weight = hn::Set(d, scores[j * kPadding + i]);
            sum = hn::MulAdd(hn::Load(d, value + j * kPadding), weight, sum);
          }
          hn::Store(sum, d, result + c);
        }
        Divide(result, totals[i], size, part(out, first + i, begin).data);
      }
    }
  }
}

void Attention(const AttentionShape& shape, ConstRows Q, ConstRows K, ConstRows V, Rows out,
               float* scratch) {
  if (shape.n_queries <= 0) return;
  if (shape.n_keys <= kFewKeys) return AttendToFew(shape, Q, K, V, out, scratch);
  const int size = shape.head_size, n_keys = shape.n_keys;
  const std::size_t key_stride = padded(n_keys), size_stride = padded(size);
  // blocks of queries of about equal height
  const int block = divide_up(shape.n_queries, divide_up(shape.n_queries, shape.kBlock));
  float* keys = scratch;
  float* values = keys + key_stride * size;
  float* zeros = values + n_keys * size_stride;
  const Rows scores{zeros + std::max(key_stride, size_stride), key_stride};
  const Rows results{scores.data + block * key_stride, size_stride};
  std::fill(zeros, scores.data, 0.0f);
  for (int head = 0; head < shape.heads; ++head) {
    const int begin = head * size;
    PackRows(part(K, 0, begin), n_keys, size, keys);
    PackValues(part(V, 0, begin), n_keys, size, values);
    for (int first = 0; first < shape.n_queries; first += block) {
      const int n = std::min(block, shape.n_queries - first);
      float total[AttentionShape::kBlock];
      GemmBlock(keys, divide_up(n_keys, kPadding), std::size_t(size) * kPadding, size,
                part(Q, first, begin), n, {zeros, 0}, scores);
      for (int i = 0; i < n; ++i) total[i] = ExpAndSum(part(scores, i).data, n_keys);
      GemmBlock(values, divide_up(size, kPadding), std::size_t(n_keys) * kPadding, n_keys, scores,
                n, {zeros, 0}, results);
      for (int i = 0; i < n; ++i) {
        Divide(part(results, i).data, total[i], size, part(out, first + i, begin).data);
      }
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace tandem::policy
HWY_AFTER_NAMESPACE();

#endif
