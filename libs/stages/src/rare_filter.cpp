// SPDX-License-Identifier: Apache-2.0
#include "rare_filter.h"

#include <algorithm>
#include <cmath>

#include "tempera/core/fast_math.h"
#include "tempera/core/parallel.h"
#include "tempera/core/vec.h"

namespace tempera {
namespace {

constexpr int kRadius = 4;  ///< pixels
// Standard deviations at kSamples samples, in pixels and frames. They shrink with the sixth root of the samples, which
// balances variance and bias of a smoother over two dimensions.
constexpr float kSpatial = 2, kTemporal = 1.5f, kSamples = 16;
// Scales of differences of guides: of normals, albedos, and of the logarithms of both kinds of light.
constexpr float kNormal = 0.3f, kAlbedo = 0.1f, kCommon = 0.3f, kRare = 1;
constexpr float kFloor = 0.2f;  ///< of the common light, added to the rare one before its logarithm
constexpr float kLeastAlbedo = 0.02f;
constexpr double kLeastLight = 1e-3;  ///< of the mean light
constexpr float kFar = 20;            ///< exponents beyond it count for nothing

/// Two passes of a binomial filter of width 3 over x and y.
Grid<float> smooth_twice(Grid<float> values) {
  const int w = values.width(), h = values.height();
  Grid<float> rows(w, h);
  for (int pass = 0; pass < 2; ++pass) {
    parallel_rows(
        0, h,
        [&](int y) {
          const float* from = values.row(y).data();
          float* to = rows.row(y).data();
          for (int x = 0; x < w; ++x)
            to[x] = 0.25f * (from[std::max(0, x - 1)] + 2 * from[x] + from[std::min(w - 1, x + 1)]);
        },
        16);
    parallel_rows(
        0, h,
        [&](int y) {
          const float *above = rows.row(std::max(0, y - 1)).data(), *here = rows.row(y).data(),
                      *below = rows.row(std::min(h - 1, y + 1)).data();
          float* to = values.row(y).data();
          for (int x = 0; x < w; ++x) to[x] = 0.25f * (above[x] + 2 * here[x] + below[x]);
        },
        16);
  }
  return values;
}

Rgb albedo_of(const RareFrame& f, int x, int y) {
  if (f.albedo.empty()) return Rgb(1.0f);
  const Rgb a = f.albedo.rgb(x, y);
  return {std::max(a.r, kLeastAlbedo), std::max(a.g, kLeastAlbedo), std::max(a.b, kLeastAlbedo)};
}

struct Tap {
  int dx, dy;
  float exponent;
};

}  // namespace

RareFilter::RareFilter(std::span<const RareFrame* const> frames, const PlanarFrames& solution)
    : frames_(frames), solution_(solution) {
  if (dark()) return;
  const int w = solution.width(), h = solution.height(), n = solution.frames();
  Grid<double> sums(h, n);
  parallel_for(
      0, std::int64_t(sums.size()),
      [&](std::int64_t i) {
        const int t = int(i / h), y = int(i % h);
        const float *r = solution.row(t, y, 0), *g = solution.row(t, y, 1), *b = solution.row(t, y, 2);
        double sum = 0;
        for (int x = 0; x < w; ++x) sum += double(luminance(Rgb(r[x], g[x], b[x])));
        sums[i] = sum;
      },
      16);
  for (const double sum : sums) mean_ += sum / (double(w) * double(h) * double(n));
}

bool RareFilter::dark() const {
  return std::all_of(frames_.begin(), frames_.end(), [](const RareFrame* f) { return f->dark; });
}

RareFilter::Guides RareFilter::make_guides(int t) const {
  const RareFrame& f = *frames_[t];
  const int w = solution_.width(), h = solution_.height();
  Guides out(w, h);
  std::array<Grid<float>, 2> rare{Grid<float>(w, h), Grid<float>(w, h)};
  Grid<float> common(w, h);
  const float least = std::max(1e-20f, float(kLeastLight * mean_));
  parallel_rows(
      0, h,
      [&](int y) {
        const float *r = solution_.row(t, y, 0), *g = solution_.row(t, y, 1), *b = solution_.row(t, y, 2);
        for (int x = 0; x < w; ++x) {
          const std::size_t i = out.index(x, y);
          Guide& guide = out[i];
          const Rgb albedo = albedo_of(f, x, y);
          for (std::size_t k = 0; k < 2; ++k) {
            const Rgb light = f.light[k].rgb(x, y);
            rare[k][i] = luminance(light);
            for (int c = 0; c < 3; ++c) guide.light[k][c] = light[c] / albedo[c];
          }
          common[i] = std::max(least, luminance(Rgb(r[x], g[x], b[x])));
          for (int c = 0; c < 3 && !f.normal.empty(); ++c) guide.features[c] = f.normal.at(x, y, c) / kNormal;
          for (int c = 0; c < 3 && !f.albedo.empty(); ++c) guide.features[3 + c] = f.albedo.at(x, y, c) / kAlbedo;
          guide.features[6] = std::log(common[i]) / kCommon;
          guide.object = f.object.empty() ? 0 : f.object.at(x, y);
        }
      },
      8);
  for (std::size_t k = 0; k < 2; ++k) {
    const Grid<float> smoothed = smooth_twice(std::move(rare[k]));
    parallel_rows(
        0, h,
        [&](int y) {
          for (int x = 0; x < w; ++x) {
            const float light = std::max(0.0f, smoothed.at(x, y)) + kFloor * common.at(x, y);
            out.at(x, y).brightness[k] = std::log(light) / kRare;
          }
        },
        16);
  }
  return out;
}

const RareFilter::Guides& RareFilter::guides(int t) {
  const auto [it, fresh] = guides_.try_emplace(t);
  if (fresh) it->second = make_guides(t);
  return it->second;
}

Grid<std::uint8_t> RareFilter::lit(int t) const {
  const RareFrame& f = *frames_[t];
  const int w = solution_.width(), h = solution_.height();
  Grid<std::uint8_t> rows(w, h), out(w, h);
  if (f.dark) return out;
  parallel_rows(
      0, h,
      [&](int y) {
        int reach = -1;  // of the last lit pixel to the left
        for (int x = 0; x < w + kRadius; ++x) {
          if (x < w && !(is_black(f.light[0].rgb(x, y)) && is_black(f.light[1].rgb(x, y)))) reach = x + kRadius;
          // Lit pixels up to x reach column x - kRadius if the last of them does.
          if (x >= kRadius) rows.at(x - kRadius, y) = reach >= x - kRadius;
        }
      },
      8);
  parallel_rows(
      0, h,
      [&](int y) {
        for (int v = std::max(0, y - kRadius); v <= std::min(h - 1, y + kRadius); ++v) {
          for (int x = 0; x < w; ++x) out.at(x, y) |= rows.at(x, v);
        }
      },
      8);
  return out;
}

Image RareFilter::smooth(int t) {
  const int w = solution_.width(), h = solution_.height(), n = solution_.frames();
  Image out(w, h, 3);
  if (dark()) return out;
  double samples = 0;
  for (const RareFrame* f : frames_) samples += double(f->samples) / n;
  const float shrink = float(std::pow(double(kSamples) / std::max(1.0, samples), 1.0 / 6));
  std::vector<Tap> taps;
  for (int dy = -kRadius; dy <= kRadius; ++dy) {
    for (int dx = -kRadius; dx <= kRadius; ++dx) {
      const int square = dx * dx + dy * dy;
      if (square <= kRadius * kRadius) taps.push_back({dx, dy, float(square) / (2 * sqr(kSpatial * shrink))});
    }
  }
  // Frames t - 1, t and t + 1 where there are such: their guides, where they are lit, and where the pixels of t are.
  struct Neighbour {
    const Guides* guides;
    Grid<std::uint8_t> lit;
    Grid<std::int32_t> place;  ///< -1: nowhere; empty: all stay where they are
    float exponent;
  };
  std::vector<Neighbour> neighbours;
  std::erase_if(guides_, [&](const auto& entry) { return entry.first < t - 1; });
  for (int u = std::max(0, t - 1); u <= std::min(n - 1, t + 1); ++u) {
    Neighbour neighbour{&guides(u), lit(u), {}, u == t ? 0 : 1 / (2 * sqr(kTemporal * shrink))};
    if (u < t) neighbour.place = frames_[t]->previous;
    if (u > t) {
      neighbour.place.assign(w, h, -1);
      const Grid<std::int32_t>& previous = frames_[u]->previous;
      for (std::size_t i = 0; i < previous.size(); ++i) {
        if (previous[i] >= 0) neighbour.place[previous[i]] = std::int32_t(i);
      }
    }
    if (u == t || !neighbour.place.empty()) neighbours.push_back(std::move(neighbour));
  }
  const Guides& own = guides(t);
  parallel_rows(
      0, h,
      [&](int y) {
        for (int x = 0; x < w; ++x) {
          const std::size_t here = own.index(x, y);
          const auto place_in = [&](const Neighbour& f) {
            return f.place.empty() ? std::int32_t(here) : f.place[here];
          };
          const bool reached = std::any_of(neighbours.begin(), neighbours.end(), [&](const Neighbour& f) {
            const std::int32_t at = place_in(f);
            return at >= 0 && f.lit[at];
          });
          if (!reached) continue;
          const Guide& g = own[here];
          std::array<Rgb, 2> sums;
          std::array<float, 2> weights{};
          for (const Neighbour& f : neighbours) {
            const std::int32_t at = place_in(f);
            if (at < 0) continue;
            const int center_x = at % w, center_y = at / w;
            for (const Tap& tap : taps) {
              const int u = center_x + tap.dx, v = center_y + tap.dy;
              if (u < 0 || v < 0 || u >= w || v >= h) continue;
              const Guide& q = f.guides->at(u, v);
              if (q.object != g.object) continue;
              float e = tap.exponent + f.exponent;
              for (std::size_t k = 0; k < q.features.size(); ++k) e += sqr(q.features[k] - g.features[k]);
              if (e > kFar) continue;
              for (std::size_t k = 0; k < 2; ++k) {
                const float difference = q.brightness[1 - k] - g.brightness[1 - k];
                constexpr float kLog2E = 1.44269504f;
                const float weight = exp2_fast(-kLog2E * std::min(e + sqr(difference), 60.0f));
                sums[k] += q.light[k] * weight;
                weights[k] += weight;
              }
            }
          }
          // The pixel itself weighs 1, so no weight is 0.
          const Rgb albedo = albedo_of(*frames_[t], x, y);
          out.set_rgb(x, y, albedo * (sums[0] * (0.5f / weights[0]) + sums[1] * (0.5f / weights[1])));
        }
      },
      4);
  return out;
}

}  // namespace tempera
