#pragma once

#include <algorithm>
#include <cstddef>

#include "policy_runtime/aligned_buffer.h"

namespace tandem::policy {

/// An image or a map of features in memory: rows of pixels, the channels of a pixel side by side.
struct Map {
  float* first = nullptr;                        ///< pixel (0, 0)
  std::size_t row_stride = 0, pixel_stride = 0;  ///< floats

  /// y and x may reach into the frame: below 0 and beyond height and width.
  float* pixel(int y, int x) const noexcept {
    return first + std::ptrdiff_t(row_stride) * y + std::ptrdiff_t(pixel_stride) * x;
  }
};

/// The shape of a map and of the frame of zeros around it, which convolutions read as padding.
struct MapShape {
  /// Height and width are rounded up to tiles of so many pixels before the frame begins, so that
  /// Winograd's tiles never read beside the map.
  static constexpr int kTile = 2;

  int height = 0, width = 0, channels = 0;
  int frame = 0;                 ///< pixels of zeros on every side
  std::size_t pixel_stride = 0;  ///< floats; padded(channels), or 3 for an image

  int tiles_down() const noexcept { return (height + kTile - 1) / kTile; }
  int tiles_across() const noexcept { return (width + kTile - 1) / kTile; }

  /// Floats of memory, whole cache lines, one of them behind the last pixel: whoever copies a few
  /// floats too many stays inside.
  std::size_t size() const noexcept {
    return padded((tiles_down() * kTile + 2 * frame) * row_stride()) + kPadding;
  }
  std::size_t row_stride() const noexcept {
    return (tiles_across() * kTile + 2 * frame) * pixel_stride;
  }

  /// The map in `memory` (size()).
  Map at(float* memory) const noexcept {
    return {memory + frame * (row_stride() + pixel_stride), row_stride(), pixel_stride};
  }

  /// Zeros everything but the pixels.
  void clear_frame(float* memory) const noexcept {
    const Map map = at(memory);
    float* dirty = memory;  // what follows the last pixel so far
    for (int y = 0; y < height; ++y) {
      std::fill(dirty, map.pixel(y, 0), 0.0f);
      dirty = map.pixel(y, width);
    }
    std::fill(dirty, memory + size(), 0.0f);
  }
};

}  // namespace tandem::policy
