// SPDX-License-Identifier: Apache-2.0
#pragma once
// Windows without motion or picture whose data have the noise of a NoiseModel: what the solver makes of them can be
// told in closed form.
#include "poisson_theory.h"
#include "synthetic_window.h"

namespace tempera::test {

inline PoissonSettings settings_of(const NoiseModel& m) {
  PoissonSettings s;
  s.norm = PoissonNorm::kL2;
  s.weights.alpha = float(m.alpha);
  s.weights.temporal = m.rows == TemporalRows::kNone ? 0 : 1;
  s.weights.mixed = m.rows == TemporalRows::kFull ? 1 : 0;
  return s;
}

/// White noise in each row; or, where replayed, in two passes of half the samples each, of which the offset pass of
/// frame t + 1 shares most of its noise with the base pass of frame t.
inline Window noisy_window(const TheoryColumn& column, int size, int frames, std::uint64_t seed) {
  const NoiseModel& m = column.model;
  PixelMap still(size, size);
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x < size; ++x) still.link(x, y, x, y);
  }
  Window window(size, size, frames);
  for (int t = 0; t + 1 < frames; ++t) window.frames[t]->motion = MotionRuns(still);
  if (!column.replayed) {
    set_data(window, [&](RowSet set, std::uint64_t address) {
      const double variance = set == RowSet::kPrimal ? m.primal
                              : set <= RowSet::kDy   ? m.gradient
                                                     : m.ratio * m.gradient;
      return std::sqrt(variance) * normal(seed, address);
    });
    return window;
  }
  // Noise of pass `offset` of frame t in the data of `set`: that of the stream t or t - 1, and some of its own.
  const auto noise = [&](RowSet set, bool offset, int t, int y, int x, int c) {
    const double variance = 2 * (set == RowSet::kPrimal ? m.primal : m.gradient);
    const double q = set == RowSet::kPrimal ? m.ratio * m.gradient / (2 * m.primal) : m.ratio / 2;
    const auto address = [&](int stream, int part) {
      return ((((std::uint64_t(stream + 1) * 4 + std::uint64_t(part)) * 3 + std::uint64_t(set)) * 3 +
               std::uint64_t(c)) *
                  std::uint64_t(size) +
              std::uint64_t(y)) *
                 std::uint64_t(size) +
             std::uint64_t(x);
    };
    return std::sqrt(variance) * (std::sqrt(1 - q) * normal(seed, address(offset ? t - 1 : t, 0)) +
                                  std::sqrt(q) * normal(seed, address(t, offset ? 1 : 2)));
  };
  parallel_for(0, frames, [&](std::int64_t n) {
    const int t = int(n);
    PoissonFrame& f = *window.frames[t];
    for_each_row(f, t + 1 == frames, [&](RowSet set, int y, int x, int, int) {
      const RowSet image = set >= RowSet::kDt ? RowSet(int(set) - int(RowSet::kDt)) : set;
      for (int c = 0; c < 3; ++c) {
        f.data(set, y, c)[x] = set >= RowSet::kDt
                                   ? float(noise(image, true, t + 1, y, x, c) - noise(image, false, t, y, x, c))
                                   : float(0.5 * (noise(image, true, t, y, x, c) + noise(image, false, t, y, x, c)));
      }
    });
  });
  return window;
}

}  // namespace tempera::test
