// SPDX-License-Identifier: Apache-2.0
#pragma once
// Motion that is as bad as it gets, for tests: moving blocks, single pixels, holes, empty rows, moves along the border.
#include <cstdint>

#include "tempera/core/grid.h"
#include "tempera/core/random.h"
#include "tempera/stages/motion_runs.h"

namespace tempera::test {

inline PixelMap random_motion(int width, int height, std::uint64_t seed) {
  PixelMap m(width, height);
  const auto random = [&](std::uint64_t x, std::uint64_t y, std::uint64_t k, int n) {
    return int(hash_key(seed, x, y, k) % std::uint64_t(n));
  };
  for (int y = 0; y < height; ++y) {
    if (y % 7 == 3) continue;
    for (int x = 0; x < width; ++x) {
      if (random(x, y, 0, 8) == 0) continue;
      // Blocks of 11 x 5 pixels that move alike, and single pixels that go anywhere.
      const int bx = x / 11, by = y / 5;
      if (random(x, y, 1, 10) == 0) {
        m.link(x, y, random(x, y, 2, width), random(x, y, 3, height));
      } else {
        m.link(x, y, x + random(bx, by, 4, 9) - 4, y + random(bx, by, 5, 5) - 2);
      }
    }
  }
  return m;
}

/// 1 with probability `share`, else 0.
inline Grid<std::uint8_t> random_mask(int width, int height, double share, std::uint64_t seed) {
  Grid<std::uint8_t> out(width, height);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = double(hash_key(seed, i) >> 11) * 0x1p-53 < share;
  return out;
}

}  // namespace tempera::test
