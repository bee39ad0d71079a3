// Winograd's transforms for 2 x 2 outputs of a 3 x 3 kernel (Lavin and Gray, arXiv 1509.09308).
#if defined(TANDEM_POLICY_KERNELS_WINOGRAD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef TANDEM_POLICY_KERNELS_WINOGRAD_INL_H_
#undef TANDEM_POLICY_KERNELS_WINOGRAD_INL_H_
#else
#define TANDEM_POLICY_KERNELS_WINOGRAD_INL_H_
#endif

#include "policy_runtime/kernels/vector-inl.h"

HWY_BEFORE_NAMESPACE();
namespace tandem::policy {
namespace HWY_NAMESPACE {

// B' v: v0 - v2, v1 + v2, v2 - v1, v1 - v3.
struct Four {
  V v0, v1, v2, v3;
};
HWY_INLINE Four TransformIn(V v0, V v1, V v2, V v3) {
  return {hn::Sub(v0, v2), hn::Add(v1, v2), hn::Sub(v2, v1), hn::Sub(v1, v3)};
}

void WinogradInput(const float* D, std::size_t row_stride, int channels, float* Y,
                   std::size_t stride) {
  const std::size_t C = channels;
  for (std::size_t c = 0; c < C; c += kLanes) {
    Four rows[4];  // B' along x
    HWY_UNROLL(4)
    for (int y = 0; y < 4; ++y) {
      const float* p = D + y * row_stride + c;
      rows[y] = TransformIn(hn::Load(d, p), hn::Load(d, p + C), hn::Load(d, p + 2 * C),
                            hn::Load(d, p + 3 * C));
    }
    const auto store = [&](int x, const Four& column) HWY_ATTR {
      float* out = Y + x * stride + c;
      hn::Store(column.v0, d, out);
      hn::Store(column.v1, d, out + 4 * stride);
      hn::Store(column.v2, d, out + 8 * stride);
      hn::Store(column.v3, d, out + 12 * stride);
    };
    store(0, TransformIn(rows[0].v0, rows[1].v0, rows[2].v0, rows[3].v0));
    store(1, TransformIn(rows[0].v1, rows[1].v1, rows[2].v1, rows[3].v1));
    store(2, TransformIn(rows[0].v2, rows[1].v2, rows[2].v2, rows[3].v2));
    store(3, TransformIn(rows[0].v3, rows[1].v3, rows[2].v3, rows[3].v3));
  }
}

// A' v: v0 + v1 + v2, v1 - v2 - v3.
struct Two {
  V v0, v1;
};
HWY_INLINE Two TransformOut(V v0, V v1, V v2, V v3) {
  return {hn::Add(hn::Add(v0, v1), v2), hn::Sub(hn::Sub(v1, v2), v3)};
}

void WinogradOut(const float* M, std::size_t stride, const WinogradOutput& tile) {
  const std::size_t C = tile.channels;
  for (std::size_t c = 0; c < C; c += kLanes) {
    Two columns[4];  // A' along y
    HWY_UNROLL(4)
    for (int x = 0; x < 4; ++x) {
      const float* p = M + x * stride + c;
      columns[x] = TransformOut(hn::Load(d, p), hn::Load(d, p + 4 * stride),
                                hn::Load(d, p + 8 * stride), hn::Load(d, p + 12 * stride));
    }
    const Two rows[2] = {TransformOut(columns[0].v0, columns[1].v0, columns[2].v0, columns[3].v0),
                         TransformOut(columns[0].v1, columns[1].v1, columns[2].v1, columns[3].v1)};
    const auto store = [&](V value, int y, int x) HWY_ATTR {
      if (tile.residual) {
        const float* residual =
            tile.residual + y * tile.residual_row_stride + x * tile.residual_pixel_stride;
        value = hn::Add(value, hn::Load(d, residual + c));
      }
      if (tile.relu) value = hn::Max(hn::Zero(d), value);
      hn::Store(value, d, tile.out + y * tile.out_row_stride + x * tile.out_pixel_stride + c);
    };
    for (int y = 0; y < tile.height; ++y) {
      store(rows[y].v0, y, 0);
      if (tile.width == 2) store(rows[y].v1, y, 1);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace tandem::policy
HWY_AFTER_NAMESPACE();

#endif
