// Many vectors through a matrix.
//
// Tiles of a few rows of X times one or a few panels live in registers while the columns go by. The
// loops around them are blocked so that the weights come from memory once for every kBlockRows rows
// of X, a panel's slice then stays in the first cache and the rows' slices in the second.
#if defined(TANDEM_POLICY_KERNELS_GEMM_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef TANDEM_POLICY_KERNELS_GEMM_INL_H_
#undef TANDEM_POLICY_KERNELS_GEMM_INL_H_
#else
#define TANDEM_POLICY_KERNELS_GEMM_INL_H_
#endif

#include <hwy/cache_control.h>

#include <algorithm>
#include <array>
#include <utility>

#include "policy_runtime/kernels/vector-inl.h"

HWY_BEFORE_NAMESPACE();
namespace tandem::policy {
namespace HWY_NAMESPACE {

// Registers that hold sums: 12 of 16 leave room for weights and x (8 without a fused multiply-add).
constexpr int kSums = kLanes == 16 ? 24 : kLanes == 8 ? 12 : 8;
constexpr int kTileRows = std::min(12, kSums / kRegisters);

// Fewer rows take more panels at once, to hide the latency of the addition.
constexpr int tile_panels(int rows) { return std::clamp(kSums / (rows * kRegisters), 1, 4); }

constexpr int kBlockRows = 120;     // of X
constexpr int kBlockColumns = 256;  // 16 KiB of a panel

// What a tile fetches into the caches meanwhile: from `from` on, `step` bytes further per column.
// The next panel's weights then come in evenly while this one computes, not all at once when the
// first tile needs them.
struct Ahead {
  const char* from;
  std::size_t step;
};

// y = start + x w' for kRows rows and kPanels panels, column after column. start may be y.
template <int kRows, int kPanels, typename Weight>
void Tile(const Weight* w, std::size_t panel_stride, int columns, ConstRows x, ConstRows start,
          Rows y, Ahead ahead) {
  constexpr int kWidth = kPanels * kRegisters;
  V sum[kRows][kWidth];
  HWY_UNROLL(12)
  for (int r = 0; r < kRows; ++r) {
    HWY_UNROLL(8)
    for (int i = 0; i < kWidth; ++i) {
      sum[r][i] = hn::LoadU(d, start.data + r * start.stride + i * kLanes);
    }
  }
  for (int column = 0; column < columns; ++column, w += kPadding) {
    HWY_UNROLL(4)
    for (int panel = 0; panel < kPanels; ++panel) {
      hwy::Prefetch(ahead.from + panel * panel_stride * sizeof(Weight));
    }
    ahead.from += ahead.step;
    const auto weights = [&](int i) {
      return LoadWeights(w + (i / kRegisters) * panel_stride + i % kRegisters * kLanes);
    };
    const auto value = [&](int r) { return hn::Set(d, x.data[r * x.stride + column]); };
    // What there is less of stays in registers; the other comes and goes.
    if constexpr (kRows > kWidth) {
      V row_of_w[kWidth];
      HWY_UNROLL(8)
      for (int i = 0; i < kWidth; ++i) row_of_w[i] = weights(i);
      HWY_UNROLL(12)
      for (int r = 0; r < kRows; ++r) {
        const V v = value(r);
        HWY_UNROLL(8)
        for (int i = 0; i < kWidth; ++i) sum[r][i] = hn::MulAdd(row_of_w[i], v, sum[r][i]);
      }
    } else {
      V column_of_x[kRows];
      HWY_UNROLL(12)
      for (int r = 0; r < kRows; ++r) column_of_x[r] = value(r);
      HWY_UNROLL(8)
      for (int i = 0; i < kWidth; ++i) {
        const V v = weights(i);
        HWY_UNROLL(12)
        for (int r = 0; r < kRows; ++r) sum[r][i] = hn::MulAdd(v, column_of_x[r], sum[r][i]);
      }
    }
  }
  HWY_UNROLL(12)
  for (int r = 0; r < kRows; ++r) {
    HWY_UNROLL(8)
    for (int i = 0; i < kWidth; ++i) hn::StoreU(sum[r][i], d, y.data + r * y.stride + i * kLanes);
  }
}

template <typename Weight>
using TileFunction = void (*)(const Weight*, std::size_t, int, ConstRows, ConstRows, Rows, Ahead);

// Entry r: tiles of r + 1 rows.
template <typename Weight, int... kRow>
constexpr auto WideTiles(std::integer_sequence<int, kRow...>) {
  return std::array<TileFunction<Weight>, kTileRows>{
      Tile<kRow + 1, tile_panels(kRow + 1), Weight>...};
}
template <typename Weight, int... kRow>
constexpr auto NarrowTiles(std::integer_sequence<int, kRow...>) {
  return std::array<TileFunction<Weight>, kTileRows>{Tile<kRow + 1, 1, Weight>...};
}

constexpr int divide_up(int a, int b) { return (a + b - 1) / b; }

// Row i of `rows`, from `column` on.
template <typename R>
R part(R rows, int i, int column = 0) {
  return {rows.data + i * rows.stride + column, rows.stride};
}

// All panels against some columns of some rows.
template <typename Weight>
void GemmBlock(const Weight* w, int panels, std::size_t panel_stride, int columns, ConstRows X,
               int n, ConstRows start, Rows Y) {
  constexpr auto kRowCounts = std::make_integer_sequence<int, kTileRows>();
  static constexpr auto kWide = WideTiles<Weight>(kRowCounts);
  static constexpr auto kNarrow = NarrowTiles<Weight>(kRowCounts);
  const int tiles = divide_up(n, kTileRows);
  const int tile_rows = divide_up(n, tiles);  // of about equal height
  const int wide = tile_panels(tile_rows);
  constexpr std::size_t kColumnBytes = kPadding * sizeof(Weight);
  const std::size_t share = columns * kColumnBytes / tiles;  // of the next panel, for each tile
  const std::size_t step = kColumnBytes / tiles + 1;
  for (int panel = 0; panel < panels;) {
    const int width = panels - panel >= wide ? wide : 1;
    for (int row = 0, t = 0; row < n; row += tile_rows, ++t) {
      const int rows = std::min(tile_rows, n - row);
      const bool fits = tile_panels(rows) == width;  // else panel by panel
      const TileFunction<Weight> tile = (fits ? kWide : kNarrow)[rows - 1];
      for (int i = panel; i < panel + width; i += fits ? width : 1) {
        const int output = i * kPadding;
        const Weight* weights = w + i * panel_stride;
        const auto* next = reinterpret_cast<const char*>(weights + width * panel_stride);
        tile(weights, panel_stride, columns, part(X, row), part(start, row, output),
             part(Y, row, output), {next + t * share, step});
      }
    }
    panel += width;
  }
}

template <typename Weight>
void GemmOf(const Weight* w, const PackedMatrix& W, ConstRows bias, ConstRows X, int n, Rows Y) {
  const int panels = divide_up(W.rows, kPadding);
  const std::size_t panel_stride = std::size_t(W.padded_columns()) * kPadding;
  const int block_rows = divide_up(n, divide_up(n, kBlockRows));
  // With a single tile nothing of the panel is used twice: read it in one go.
  const int block_columns =
      n <= kTileRows ? W.columns : divide_up(W.columns, divide_up(W.columns, kBlockColumns));
  for (int row = 0; row < n; row += block_rows) {
    const int rows = std::min(block_rows, n - row);
    for (int column = 0; column < W.columns; column += block_columns) {
      GemmBlock(w + std::size_t(column) * kPadding, panels, panel_stride,
                std::min(block_columns, W.columns - column), part(X, row, column), rows,
                column == 0 ? part(bias, row) : ConstRows(part(Y, row)), part(Y, row));
    }
  }
}

void Gemm(const PackedMatrix& W, ConstRows bias, ConstRows X, int n, Rows Y) {
  if (n <= 0) return;
  if (W.precision == Precision::kFloat32) return GemmOf(W.data, W, bias, X, n, Y);
  GemmOf(W.data_bf16, W, bias, X, n, Y);
}

}  // namespace HWY_NAMESPACE
}  // namespace tandem::policy
HWY_AFTER_NAMESPACE();

#endif
