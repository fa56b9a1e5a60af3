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

std::size_t pixel_index(int x, int y, int w) { return std::size_t(y) * std::size_t(w) + std::size_t(x); }

/// Two passes of a binomial filter of width 3 over x and y.
std::vector<float> smooth_twice(std::vector<float> values, int w, int h) {
  std::vector<float> rows(values.size());
  for (int pass = 0; pass < 2; ++pass) {
    parallel_for(
        0, h,
        [&](std::int64_t y) {
          const float* from = values.data() + pixel_index(0, int(y), w);
          float* to = rows.data() + pixel_index(0, int(y), w);
          for (int x = 0; x < w; ++x)
            to[x] = 0.25f * (from[std::max(0, x - 1)] + 2 * from[x] + from[std::min(w - 1, x + 1)]);
        },
        16);
    parallel_for(
        0, h,
        [&](std::int64_t row) {
          const int y = int(row);
          const float *above = rows.data() + pixel_index(0, std::max(0, y - 1), w),
                      *here = rows.data() + pixel_index(0, y, w),
                      *below = rows.data() + pixel_index(0, std::min(h - 1, y + 1), w);
          float* to = values.data() + pixel_index(0, y, w);
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
  std::vector<double> rows(std::size_t(n) * std::size_t(h));
  parallel_for(
      0, std::int64_t(rows.size()),
      [&](std::int64_t i) {
        const int t = int(i / h), y = int(i % h);
        const float *r = solution.row(t, y, 0), *g = solution.row(t, y, 1), *b = solution.row(t, y, 2);
        double sum = 0;
        for (int x = 0; x < w; ++x) sum += double(luminance(Rgb(r[x], g[x], b[x])));
        rows[i] = sum;
      },
      16);
  for (const double sum : rows) mean_ += sum / (double(w) * double(h) * double(n));
}

bool RareFilter::dark() const {
  return std::all_of(frames_.begin(), frames_.end(), [](const RareFrame* f) { return f->dark; });
}

RareFilter::Guides RareFilter::make_guides(int t) const {
  const RareFrame& f = *frames_[t];
  const int w = solution_.width(), h = solution_.height();
  Guides out(std::size_t(w) * std::size_t(h));
  std::array<std::vector<float>, 2> rare{std::vector<float>(out.size()), std::vector<float>(out.size())};
  std::vector<float> common(out.size());
  const float least = std::max(1e-20f, float(kLeastLight * mean_));
  parallel_for(
      0, h,
      [&](std::int64_t row) {
        const int y = int(row);
        const float *r = solution_.row(t, y, 0), *g = solution_.row(t, y, 1), *b = solution_.row(t, y, 2);
        for (int x = 0; x < w; ++x) {
          const std::size_t i = pixel_index(x, y, w);
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
    const std::vector<float> smoothed = smooth_twice(std::move(rare[k]), w, h);
    parallel_for(
        0, h,
        [&](std::int64_t y) {
          for (std::size_t i = pixel_index(0, int(y), w), end = i + std::size_t(w); i < end; ++i)
            out[i].brightness[k] = std::log(std::max(0.0f, smoothed[i]) + kFloor * common[i]) / kRare;
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

std::vector<std::uint8_t> RareFilter::lit(int t) const {
  const RareFrame& f = *frames_[t];
  const int w = solution_.width(), h = solution_.height();
  std::vector<std::uint8_t> rows(std::size_t(w) * std::size_t(h)), out(rows.size());
  if (f.dark) return out;
  parallel_for(
      0, h,
      [&](std::int64_t row) {
        const int y = int(row);
        int reach = -1;  // of the last lit pixel to the left
        for (int x = 0; x < w + kRadius; ++x) {
          if (x < w && !(is_black(f.light[0].rgb(x, y)) && is_black(f.light[1].rgb(x, y)))) reach = x + kRadius;
          // Lit pixels up to x reach column x - kRadius if the last of them does.
          if (x >= kRadius) rows[pixel_index(x - kRadius, y, w)] = reach >= x - kRadius;
        }
      },
      8);
  parallel_for(
      0, h,
      [&](std::int64_t row) {
        const int y = int(row);
        for (int v = std::max(0, y - kRadius); v <= std::min(h - 1, y + kRadius); ++v) {
          for (int x = 0; x < w; ++x) out[pixel_index(x, y, w)] |= rows[pixel_index(x, v, w)];
        }
      },
      8);
  return out;
}

Image RareFilter::smooth(int t) {
  const int w = solution_.width(), h = solution_.height(), n = int(frames_.size());
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
    std::vector<std::uint8_t> lit;
    std::vector<std::int32_t> place;  ///< -1: nowhere; empty: all stay where they are
    float exponent;
  };
  std::vector<Neighbour> neighbours;
  std::erase_if(guides_, [&](const auto& entry) { return entry.first < t - 1; });
  for (int u = std::max(0, t - 1); u <= std::min(n - 1, t + 1); ++u) {
    Neighbour neighbour{&guides(u), lit(u), {}, u == t ? 0 : 1 / (2 * sqr(kTemporal * shrink))};
    if (u < t) neighbour.place = frames_[t]->previous;
    if (u > t) {
      neighbour.place.assign(out.pixels(), -1);
      const std::vector<std::int32_t>& previous = frames_[u]->previous;
      for (std::size_t i = 0; i < previous.size(); ++i) {
        if (previous[i] >= 0) neighbour.place[previous[i]] = std::int32_t(i);
      }
    }
    if (u == t || !neighbour.place.empty()) neighbours.push_back(std::move(neighbour));
  }
  const Guides& own = guides(t);
  parallel_for(
      0, h,
      [&](std::int64_t row) {
        const int y = int(row);
        for (int x = 0; x < w; ++x) {
          const std::size_t here = pixel_index(x, y, w);
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
              const Guide& q = (*f.guides)[pixel_index(u, v, w)];
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
