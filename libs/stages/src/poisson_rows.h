// SPDX-License-Identifier: Apache-2.0
#pragma once
// The rows of a PoissonSystem pixel by pixel, for processors that have a thread for each: functions of one row or one
// pixel alone, which compile for the host and for CUDA devices. The host's own solver goes by runs instead
// (poisson.cpp).
//
// Pixels of all frames are numbered g = (t * height + y) * width + x; rows by their set and pixel.
#include <span>
#include <vector>

#include "tempera/stages/poisson.h"

#ifdef __CUDACC__
#define TEMPERA_DEVICE __host__ __device__
#else
#define TEMPERA_DEVICE
#endif

namespace tempera {

/// Which rows there are, and what they connect.
struct FlatRows {
  int width = 0, height = 0, frames = 0;
  const int* forward = nullptr;          ///< [pixels] phi: the pixel of the next frame; -1: none
  const int* backward = nullptr;         ///< [pixels] its inverse: the pixel of the frame before
  const unsigned char* mixed = nullptr;  ///< [pixels] 1: the row of kDxDt exists, 2: that of kDyDt

  TEMPERA_DEVICE int pixels() const { return width * height * frames; }
  TEMPERA_DEVICE bool exists(RowSet set, int g) const {
    switch (set) {
      case RowSet::kPrimal:
        return true;
      case RowSet::kDx:
        return g % width + 1 < width;
      case RowSet::kDy:
        return g / width % height + 1 < height;
      case RowSet::kDt:
        return forward[g] >= 0;
      case RowSet::kDxDt:
        return (mixed[g] & 1) != 0;
      default:
        return (mixed[g] & 2) != 0;
    }
  }
  /// A x of one row that exists, without its weight. x: [pixels][3].
  TEMPERA_DEVICE float value(RowSet set, int g, const float* x, int c) const {
    const auto at = [&](int i) { return x[3 * i + c]; };
    const int step = set == RowSet::kDy || set == RowSet::kDyDt ? width : 1;
    switch (set) {
      case RowSet::kPrimal:
        return at(g);
      case RowSet::kDx:
      case RowSet::kDy:
        return at(g + step) - at(g);
      case RowSet::kDt:
        return at(forward[g]) - at(g);
      default:
        return (at(forward[g] + step) - at(forward[g])) - (at(g + step) - at(g));
    }
  }
  /// Calls use(set, row, coefficient) for all rows that reach pixel g, in an order of its own.
  template <class Use>
  TEMPERA_DEVICE void for_each_row_of(int g, Use&& use) const {
    const int x = g % width, y = g / width % height;
    const auto use_if = [&](RowSet set, int row, float coefficient) {
      if (exists(set, row)) use(set, row, coefficient);
    };
    use(RowSet::kPrimal, g, 1.0f);
    use_if(RowSet::kDx, g, -1);
    if (x > 0) use_if(RowSet::kDx, g - 1, 1);
    use_if(RowSet::kDy, g, -1);
    if (y > 0) use_if(RowSet::kDy, g - width, 1);
    // To the next frame.
    use_if(RowSet::kDt, g, -1);
    use_if(RowSet::kDxDt, g, 1);
    if (x > 0) use_if(RowSet::kDxDt, g - 1, -1);
    use_if(RowSet::kDyDt, g, 1);
    if (y > 0) use_if(RowSet::kDyDt, g - width, -1);
    // From the frame before: the row of the pixel that moves here, and those of pixels that move beside it.
    if (const int from = backward[g]; from >= 0) {
      use(RowSet::kDt, from, 1.0f);
      use_if(RowSet::kDxDt, from, -1);
      use_if(RowSet::kDyDt, from, -1);
    }
    if (x > 0 && backward[g - 1] >= 0) use_if(RowSet::kDxDt, backward[g - 1], 1);
    if (y > 0 && backward[g - width] >= 0) use_if(RowSet::kDyDt, backward[g - width], 1);
  }
};

/// The rows of a window with their data, in memory of the host.
struct FlatWindow {
  /// Pre: as PoissonSystem.
  explicit FlatWindow(std::span<const PoissonFrame* const> window);
  FlatRows rows() const { return {width, height, frames, forward.data(), backward.data(), mixed.data()}; }
  std::size_t pixels() const { return forward.size(); }

  int width, height, frames;
  std::vector<int> forward, backward;
  std::vector<unsigned char> mixed;
  std::vector<float> data;       ///< [set][pixels][3]; 0 where a row does not exist
  std::vector<float> precision;  ///< [set][pixels]; empty: the frames have none
};

}  // namespace tempera
