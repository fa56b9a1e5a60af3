// SPDX-License-Identifier: Apache-2.0
#pragma once
// Windows with known solutions for tests and benchmarks of the Poisson solver: pictures that move by whole pixels,
// their exact differences, and noise on each datum.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "tempera/core/parallel.h"
#include "tempera/core/random.h"
#include "tempera/core/vec.h"
#include "tempera/stages/poisson.h"

namespace tempera::test {

/// Uniform in [0, 1), a function of the address.
inline double uniform(std::uint64_t seed, std::uint64_t i, std::uint64_t k = 0) {
  return double(hash_key(seed, i, k) >> 11) * 0x1p-53;
}
/// Standard normal.
inline double normal(std::uint64_t seed, std::uint64_t i) {
  return std::sqrt(-2 * std::log(1 - uniform(seed, i, 1))) * std::cos(2 * kPiD * uniform(seed, i, 2));
}

/// A window with the frames that it owns.
struct Window {
  std::vector<std::unique_ptr<PoissonFrame>> frames;
  PlanarFrames truth;
  std::int64_t linked = 0;  ///< pixels with a partner in the next frame

  Window(int width, int height, int count) : truth(width, height, count) {
    for (int t = 0; t < count; ++t) frames.push_back(std::make_unique<PoissonFrame>(width, height));
  }
  std::vector<const PoissonFrame*> span() const {
    std::vector<const PoissonFrame*> out;
    for (const auto& f : frames) out.push_back(f.get());
    return out;
  }
};

/// Calls row(set, y, x, to_x, to_y) for every row of A of the frame; to_* is phi(x, y) for temporal and mixed ones.
template <class F>
void for_each_row(const PoissonFrame& frame, bool last, F&& row) {
  const int w = frame.width(), h = frame.height();
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      row(RowSet::kPrimal, y, x, 0, 0);
      if (x + 1 < w) row(RowSet::kDx, y, x, 0, 0);
      if (y + 1 < h) row(RowSet::kDy, y, x, 0, 0);
    }
    if (last || frame.motion.count() == 0) continue;
    for (const MotionRun& r : frame.motion.from_row(y)) {
      for (int i = 0; i < r.length; ++i) {
        const int x = r.x + i, to_x = x + r.dx, to_y = y + r.dy;
        row(RowSet::kDt, y, x, to_x, to_y);
        if (i < r.mixed_x) row(RowSet::kDxDt, y, x, to_x, to_y);
        if (r.mixed_y) row(RowSet::kDyDt, y, x, to_x, to_y);
      }
    }
  }
}

/// The pixels that a row of A reaches, with their coefficients.
struct RowEntry {
  int t, y, x;
  double coefficient;
};
inline std::vector<RowEntry> row_entries(RowSet set, int t, int y, int x, int to_x, int to_y) {
  switch (set) {
    case RowSet::kPrimal:
      return {{t, y, x, 1}};
    case RowSet::kDx:
      return {{t, y, x + 1, 1}, {t, y, x, -1}};
    case RowSet::kDy:
      return {{t, y + 1, x, 1}, {t, y, x, -1}};
    case RowSet::kDt:
      return {{t + 1, to_y, to_x, 1}, {t, y, x, -1}};
    case RowSet::kDxDt:
      return {{t + 1, to_y, to_x + 1, 1}, {t + 1, to_y, to_x, -1}, {t, y, x + 1, -1}, {t, y, x, 1}};
    case RowSet::kDyDt:
      break;
  }
  return {{t + 1, to_y + 1, to_x, 1}, {t + 1, to_y, to_x, -1}, {t, y + 1, x, -1}, {t, y, x, 1}};
}

/// Sets all data to A truth, and adds noise(set, address) to each.
template <class Noise>
void set_data(Window& window, Noise&& noise) {
  const int frames = int(window.frames.size()), w = window.truth.width(), h = window.truth.height();
  parallel_for(0, frames, [&](std::int64_t n) {
    const int t = int(n);
    PoissonFrame& f = *window.frames[t];
    for_each_row(f, t + 1 == frames, [&](RowSet set, int y, int x, int to_x, int to_y) {
      const std::vector<RowEntry> entries = row_entries(set, t, y, x, to_x, to_y);
      for (int c = 0; c < 3; ++c) {
        double v = 0;
        for (const RowEntry& e : entries) v += e.coefficient * double(window.truth.row(e.t, e.y, c)[e.x]);
        const std::uint64_t address =
            (((std::uint64_t(t) * kRowSets + std::uint64_t(set)) * h + std::uint64_t(y)) * w + std::uint64_t(x)) * 3 +
            std::uint64_t(c);
        f.data(set, y, c)[x] = float(v + noise(set, address));
      }
    });
  });
}

/// Noise of the specification's experiments: Gaussian, `sigma_primal` and `sigma_gradient`, where a fraction of the
/// data has it 15 times as large.
struct SampledNoise {
  double sigma_primal = 0.1, sigma_gradient = 0.02, outliers = 0.005;
  std::uint64_t seed = 1;
  double operator()(RowSet set, std::uint64_t address) const {
    const double sigma = set == RowSet::kPrimal ? sigma_primal : sigma_gradient;
    return sigma * normal(seed, address) * (uniform(seed, address, 3) < outliers ? 15 : 1);
  }
};

/// A textured background that moves by (3, 1) pixels a frame under `discs` discs with motions of their own: 97 to 98 %
/// of the pixels have a partner.
inline Window pan_with_discs(int width, int height, int count, int discs = 14) {
  Window window(width, height, count);
  struct Disc {
    double x, y, radius;
    int vx, vy;
  };
  std::vector<Disc> list;
  const double size = height;
  for (int d = 0; d < discs; ++d) {
    const auto u = [&](int k) { return uniform(99, std::uint64_t(d), std::uint64_t(k)); };
    list.push_back({u(0) * width, u(1) * height, size * (0.03 + 0.07 * u(2)), int(u(3) * 13) - 6, int(u(4) * 9) - 4});
  }
  const auto object_at = [&](int x, int y, int t) {
    for (int d = discs - 1; d >= 0; --d) {
      const Disc& k = list[d];
      const double dx = x - k.x - k.vx * t, dy = y - k.y - k.vy * t;
      if (dx * dx + dy * dy < k.radius * k.radius) return d;
    }
    return -1;
  };
  const auto velocity = [&](int d) { return d < 0 ? Vec2<int>{3, 1} : Vec2<int>{list[d].vx, list[d].vy}; };
  parallel_for(0, count, [&](std::int64_t n) {
    const int t = int(n);
    PixelMap motion(width, height);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const int d = object_at(x, y, t);
        const Vec2<int> v = velocity(d);
        const double px = (x - v.x * t) / size, py = (y - v.y * t) / size;
        for (int c = 0; c < 3; ++c) {
          double value = 0.5 + 0.2 * std::sin(9 * px + c + d) * std::cos(7 * py - d) + 0.1 * std::sin(31 * px * py + c);
          if (d < 0 && (int(std::floor(8 * px)) + int(std::floor(8 * py))) % 2 != 0) value *= 0.6;
          window.truth.row(t, y, c)[x] = float(value);
        }
        if (t + 1 < count) {
          const int tx = x + v.x, ty = y + v.y;
          if (tx >= 0 && ty >= 0 && tx < width && ty < height && object_at(tx, ty, t + 1) == d) {
            motion.link(x, y, tx, ty);
          }
        }
      }
    }
    if (t + 1 < count) window.frames[t]->motion = MotionRuns(motion);
  });
  for (const auto& f : window.frames) window.linked += f->motion.count();
  return window;
}

/// The primal data, the usual start.
inline PlanarFrames primal_data(const Window& window) {
  PlanarFrames x(window.truth.width(), window.truth.height(), window.truth.frames());
  for (int t = 0; t < x.frames(); ++t) {
    for (int y = 0; y < x.height(); ++y) {
      for (int c = 0; c < 3; ++c) {
        std::copy_n(window.frames[t]->data(RowSet::kPrimal, y, c), x.width(), x.row(t, y, c));
      }
    }
  }
  return x;
}

inline double rms_difference(const PlanarFrames& a, const PlanarFrames& b) {
  double sum = 0;
  for (int t = 0; t < a.frames(); ++t) {
    for (int y = 0; y < a.height(); ++y) {
      for (int c = 0; c < 3; ++c) {
        for (int x = 0; x < a.width(); ++x) {
          const double d = double(a.row(t, y, c)[x]) - double(b.row(t, y, c)[x]);
          sum += d * d;
        }
      }
    }
  }
  return std::sqrt(sum / (3.0 * a.width() * a.height() * a.frames()));
}

}  // namespace tempera::test
