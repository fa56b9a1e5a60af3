// SPDX-License-Identifier: Apache-2.0
// Frames between keys as Zimmer et al. make them, to compare with: what keys show is projected to the frame along motion
// vectors. [Zimmer 2015, Sec. 5.3]
#include <algorithm>
#include <cmath>

#include "motion/interpolation.h"
#include "tempera/core/parallel.h"

namespace tempera::motion {

namespace {

using denoise::Planes;

constexpr float kBehind = 1.02f;     // times the least depth: what is farther is hidden
constexpr float kCovered = 0.25f;    // of a pixel, by what is projected to it: less is a hole
constexpr float kSilhouette = 0.5f;  // pixels: neighbors of two objects that move apart by more are a silhouette
constexpr float kSeam = 0.05f;  // of the light: keys that differ by more leave a seam beside what one of them lacks
constexpr int kSeamRadius = 2;
constexpr int kFour[4][2] = {{0, -1}, {-1, 0}, {1, 0}, {0, 1}};

/// What a key says of the frame.
struct Projected {
  Planes irradiance, reflectance;  ///< [h,w,3]
  Planes color;                    ///< [h,w,3] their product, with emission
  Planes covered;                  ///< [h,w,1] by how much
  bool has(int x, int y) const { return covered.row(0, y)[x] >= kCovered; }
};

/// Pixels that mix what moves apart: their vectors say nothing. [Zimmer 2015, Sec. 4.3]
/// DEVIATION [Zimmer 2015, Sec. 4.3]: found in the picture, by objects and their vectors, not as edges of the meshes.
Grid<std::uint8_t> silhouettes(const Surfaces& s) {
  Grid<std::uint8_t> out(s.width(), s.height());
  for (int y = 0; y < s.height(); ++y) {
    for (int x = 0; x < s.width(); ++x) {
      const std::size_t i = s.linear.index(x, y);
      for (const auto& o : kFour) {
        const int nx = x + o[0], ny = y + o[1];
        if (nx < 0 || ny < 0 || nx >= s.width() || ny >= s.height()) continue;
        const std::size_t j = s.linear.index(nx, ny);
        if (s.vectors[j] == kNothing || s.id.empty() || s.id[i] == s.id[j]) continue;
        const float dx = s.linear[i].x - s.linear[j].x, dy = s.linear[i].y - s.linear[j].y;
        if (dx * dx + dy * dy > kSilhouette * kSilhouette) out[i] = 1;
      }
    }
  }
  return out;
}

/// Calls f(pixel, weight) for the four pixels around a place.
template <class F>
void around(const Place& p, int w, int h, const F& f) {
  const float fx = p.x - 0.5f, fy = p.y - 0.5f;
  const int x0 = int(std::floor(fx)), y0 = int(std::floor(fy));
  const float u = fx - float(x0), v = fy - float(y0);
  for (int k = 0; k < 4; ++k) {
    const int x = x0 + (k & 1), y = y0 + (k >> 1);
    const float weight = ((k & 1) ? u : 1 - u) * ((k >> 1) ? v : 1 - v);
    if (x >= 0 && y >= 0 && x < w && y < h && weight > 0) f(x, y, weight);
  }
}

Projected project_key(const Frame& key, int number, const Part& part, const Surfaces& s, const Grid<Place>& places) {
  const int w = s.width(), h = s.height();
  const Light light(key, part, "key", number);
  const Planes irradiance = light.irradiance(light.color);
  const Grid<std::uint8_t> mixed = silhouettes(s);
  const auto depth = [&](std::size_t i) { return s.depth.empty() ? 0.0f : s.depth[i]; };
  Grid<float> nearest(w, h, kFar);
  const auto each = [&](const auto& f) {
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        const std::size_t i = s.linear.index(x, y);
        if (!places[i].valid() || mixed[i] || s.vectors[i] == kNothing) continue;
        around(places[i], w, h, [&](int tx, int ty, float weight) { f(x, y, i, tx, ty, weight); });
      }
    }
  };
  each([&](int, int, std::size_t i, int tx, int ty, float) {
    nearest.at(tx, ty) = std::min(nearest.at(tx, ty), depth(i));
  });
  Projected out{Planes(w, h, 3), Planes(w, h, 3), Planes(w, h, 3), Planes(w, h, 1)};
  each([&](int x, int y, std::size_t i, int tx, int ty, float weight) {
    if (depth(i) > kBehind * nearest.at(tx, ty)) return;
    out.covered.row(0, ty)[tx] += weight;
    for (int c = 0; c < 3; ++c) {
      out.irradiance.row(c, ty)[tx] += weight * irradiance.row(c, y)[x];
      out.reflectance.row(c, ty)[tx] += weight * light.divisor.row(c, y)[x];
      out.color.row(c, ty)[tx] += weight * light.emission.row(c, y)[x];
    }
  });
  parallel_rows(0, h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      const float sum = std::max(out.covered.row(0, y)[x], 1e-6f);
      for (int c = 0; c < 3; ++c) {
        float &e = out.irradiance.row(c, y)[x], &r = out.reflectance.row(c, y)[x], &l = out.color.row(c, y)[x];
        e /= sum, r /= sum, l = l / sum + e * r;
      }
    }
  });
  return out;
}

/// Marks the regions that only one key shows, where both keys differ beside them.
void mark_seams(const Projected& a, const Projected& b, Grid<std::uint8_t>& unwanted) {
  const int w = unwanted.width(), h = unwanted.height();
  Planes differ(w, h, 2);  // and where both are known
  parallel_rows(0, h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      if (!a.has(x, y) || !b.has(x, y)) continue;
      float d = 0, sum = 0;
      for (int c = 0; c < 3; ++c) {
        d += std::abs(a.color.row(c, y)[x] - b.color.row(c, y)[x]);
        sum += 0.5f * (a.color.row(c, y)[x] + b.color.row(c, y)[x]) + 0.01f;
      }
      differ.row(0, y)[x] = d / sum, differ.row(1, y)[x] = 1;
    }
  });
  const Planes mean = denoise::box_mean(differ, kSeamRadius);
  std::vector<std::size_t> ring;
  const auto single = [&](int x, int y) { return a.has(x, y) != b.has(x, y); };
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (!single(x, y) || mean.row(1, y)[x] == 0) continue;
      if (mean.row(0, y)[x] > kSeam * mean.row(1, y)[x]) unwanted.at(x, y) = 1, ring.push_back(unwanted.index(x, y));
    }
  }
  while (!ring.empty()) {
    const std::size_t i = ring.back();
    ring.pop_back();
    const int x = int(i % std::size_t(w)), y = int(i / std::size_t(w));
    for (const auto& o : kFour) {
      const int nx = x + o[0], ny = y + o[1];
      if (nx < 0 || ny < 0 || nx >= w || ny >= h || unwanted.at(nx, ny) || !single(nx, ny)) continue;
      unwanted.at(nx, ny) = 1, ring.push_back(unwanted.index(nx, ny));
    }
  }
}

}  // namespace

Made interpolate_published(const BetweenKeys& in) {
  const auto project = [&](const Frame& key, int number) {
    const int step = in.frame > number ? 1 : -1;
    std::vector<const Surfaces*> way;
    for (int f = number; f != in.frame + step; f += step) way.push_back(&in.surfaces.at(f));
    return project_key(key, number, in.part, *way.front(), walk(way, step));
  };
  const Projected a = project(in.key_before, in.before), b = project(in.key_after, in.after);
  const Surfaces& here = in.surfaces.at(in.frame);
  const int w = here.width(), h = here.height();
  const float share = in.share();
  Made out{Planes(w, h, 3), Grid<std::uint8_t>(w, h)};
  Grid<std::uint8_t> holes = silhouettes(here);
  parallel_rows(0, h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      const float of_a = a.has(x, y) ? 1 - share : 0, of_b = b.has(x, y) ? share : 0, sum = of_a + of_b;
      holes.at(x, y) |= sum == 0 && here.vectors[here.linear.index(x, y)] != kNothing;
      for (int c = 0; c < 3; ++c)
        out.color.row(c, y)[x] = (of_a * a.color.row(c, y)[x] + of_b * b.color.row(c, y)[x]) / std::max(sum, 1e-6f);
    }
  });
  mark_seams(a, b, holes);
  // What is beside a hole is made of pixels that cover it in part.
  parallel_rows(0, h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      std::uint8_t want = holes.at(x, y);
      for (const auto& o : kAround) {
        const int nx = x + o[0], ny = y + o[1];
        if (nx >= 0 && ny >= 0 && nx < w && ny < h) want |= holes.at(nx, ny);
      }
      out.unwanted.at(x, y) = want;
    }
  });
  return out;
}

}  // namespace tempera::motion
