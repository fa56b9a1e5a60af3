// SPDX-License-Identifier: Apache-2.0
// Frames between keys as Zimmer et al. make them, to compare with: what keys show is projected to the frame along motion
// vectors. [Zimmer 2015, Sec. 5.3]
#include <algorithm>
#include <cmath>

#include "motion/flow.h"
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
  Grid<std::uint8_t> known;
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

/// Averages of the values that are projected to each pixel, bilinearly, of what is not hidden there.
struct Splats {
  Planes values;
  Planes covered;  ///< [h,w,1] by how much
};
Splats project(const Planes& values, const Surfaces& s, const Grid<std::uint8_t>& mixed, const Grid<Place>& places) {
  const int w = s.width(), h = s.height();
  const auto depth = [&](std::size_t i) { return s.depth.empty() ? 0.0f : s.depth[i]; };
  const auto each = [&](const auto& f) {
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        const std::size_t i = s.linear.index(x, y);
        if (!places[i].valid() || mixed[i] || s.vectors[i] == kNothing) continue;
        around(places[i], w, h, [&](int tx, int ty, float weight) { f(x, y, depth(i), tx, ty, weight); });
      }
    }
  };
  Grid<float> nearest(w, h, kFar);
  each([&](int, int, float z, int tx, int ty, float) { nearest.at(tx, ty) = std::min(nearest.at(tx, ty), z); });
  Splats out{Planes(w, h, values.channels()), Planes(w, h, 1)};
  each([&](int x, int y, float z, int tx, int ty, float weight) {
    if (z > kBehind * nearest.at(tx, ty)) return;
    out.covered.row(0, ty)[tx] += weight;
    for (int c = 0; c < values.channels(); ++c) out.values.row(c, ty)[tx] += weight * values.row(c, y)[x];
  });
  denoise::for_values(out.values,
                      [&](int, int y, int x, float v) { return v / std::max(out.covered.row(0, y)[x], 1e-6f); });
  return out;
}

/// `places`: where the surfaces of the key are, `of_light`: where their light is.
Projected project_key(const Light& light, const Planes& irradiance, const Surfaces& s, const Grid<Place>& places,
                      const Grid<Place>& of_light) {
  const int w = s.width(), h = s.height();
  const Grid<std::uint8_t> mixed = silhouettes(s);
  Splats e = project(irradiance, s, mixed, of_light), r = project(light.divisor, s, mixed, places);
  const Splats emission = project(light.emission, s, mixed, places);
  Projected out{std::move(e.values), std::move(r.values), emission.values, Grid<std::uint8_t>(w, h)};
  denoise::for_values(out.color, [&](int c, int y, int x, float v) {
    return v + out.irradiance.row(c, y)[x] * out.reflectance.row(c, y)[x];
  });
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x)
      out.known.at(x, y) = e.covered.row(0, y)[x] >= kCovered && r.covered.row(0, y)[x] >= kCovered;
  }
  return out;
}

#ifdef TEMPERA_PATH_SPACE_MOTION
/// Where light is in between, by its flow from one key to the other; where that is not known, where the surface is.
/// [Zimmer 2015, Sec. 4.2]
Grid<Place> along_flow(const LightFlow& flow, const Grid<std::uint8_t>& known, float share, const Grid<Place>& places) {
  Grid<Place> out = places;
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      if (!known.at(x, y)) continue;
      const Vec2f& v = flow.vectors.at(x, y);
      const Place p{float(x) + 0.5f + share * v.x, float(y) + 0.5f + share * v.y};
      if (p.x >= 0 && p.y >= 0 && p.x < float(out.width()) && p.y < float(out.height())) out.at(x, y) = p;
    }
  }
  return out;
}
#endif

/// Marks the regions that only one key shows, where both keys differ beside them.
void mark_seams(const Projected& a, const Projected& b, Grid<std::uint8_t>& unwanted) {
  const int w = unwanted.width(), h = unwanted.height();
  Planes differ(w, h, 2);  // and where both are known
  parallel_rows(0, h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      if (!a.known.at(x, y) || !b.known.at(x, y)) continue;
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
  const auto single = [&](int x, int y) { return a.known.at(x, y) != b.known.at(x, y); };
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
  const auto places = [&](int from, int to) {
    const int step = to > from ? 1 : -1;
    std::vector<const Surfaces*> way;
    for (int f = from; f != to + step; f += step) way.push_back(&in.surfaces.at(f));
    return walk(way, step);
  };
  const Light light_a(in.key_before, in.part, "key", in.before), light_b(in.key_after, in.part, "key", in.after);
  const Planes irradiance_a = light_a.irradiance(light_a.color), irradiance_b = light_b.irradiance(light_b.color);
  const Surfaces &surfaces_a = in.surfaces.at(in.before), &surfaces_b = in.surfaces.at(in.after);
  const Grid<Place> places_a = places(in.before, in.frame), places_b = places(in.after, in.frame);
  Grid<Place> of_light_a = places_a, of_light_b = places_b;
#ifdef TEMPERA_PATH_SPACE_MOTION
  if (in.follow_light) {
    const LightFlow forward = irradiance_flow(irradiance_a, irradiance_b, places(in.before, in.after), surfaces_a.id);
    const LightFlow backward = irradiance_flow(irradiance_b, irradiance_a, places(in.after, in.before), surfaces_b.id);
    of_light_a = along_flow(forward, consistent(forward, backward), in.share(), places_a);
    of_light_b = along_flow(backward, consistent(backward, forward), 1 - in.share(), places_b);
  }
#endif
  const Projected a = project_key(light_a, irradiance_a, surfaces_a, places_a, of_light_a);
  const Projected b = project_key(light_b, irradiance_b, surfaces_b, places_b, of_light_b);
  const Surfaces& here = in.surfaces.at(in.frame);
  const int w = here.width(), h = here.height();
  const float share = in.share();
  Made out{Planes(w, h, 3), Grid<std::uint8_t>(w, h)};
  Grid<std::uint8_t> holes = silhouettes(here);
  parallel_rows(0, h, [&](int y) {
    for (int x = 0; x < w; ++x) {
      const float of_a = a.known.at(x, y) ? 1 - share : 0, of_b = b.known.at(x, y) ? share : 0, sum = of_a + of_b;
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
