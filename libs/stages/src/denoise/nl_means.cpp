// SPDX-License-Identifier: Apache-2.0
#include "denoise/nl_means.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "tempera/core/fast_math.h"

namespace tempera::denoise {

namespace {

constexpr int kTileWidth = 64, kTileHeight = 32;
constexpr float kCutoff = 9;  ///< distances beyond it weigh nothing: of hundreds of neighbours, none of these counts
constexpr float kLog2E = 1.44269504f;

/// A tile of planes with a margin, in memory of its own. Outside of the picture all is 0.
class Margin {
 public:
  Margin(int width, int height, int channels)
      : stride_(width), height_(height), data_(std::size_t(width) * std::size_t(height) * std::size_t(channels)) {}
  int stride() const { return stride_; }
  float* row(int c, int y) { return data_.data() + std::size_t(c * height_ + y) * std::size_t(stride_); }
  const float* row(int c, int y) const { return data_.data() + std::size_t(c * height_ + y) * std::size_t(stride_); }
  void fill(float value) { std::fill(data_.begin(), data_.end(), value); }
  /// Copies what of `in` lies under it, with its upper left corner at (left, top), to channels from `channel` on.
  void load(const Planes& in, int left, int top, int channel = 0) {
    for (int c = 0; c < in.channels(); ++c) {
      for (int y = 0; y < height_; ++y) {
        float* to = row(channel + c, y);
        const int source = top + y;
        std::fill(to, to + stride_, 0.0f);
        if (source < 0 || source >= in.height()) continue;
        const int first = std::max(left, 0), last = std::min(left + stride_, in.width());
        if (first < last)
          std::memcpy(to + (first - left), in.row(c, source) + first, sizeof(float) * std::size_t(last - first));
      }
    }
  }
  /// 1 inside of the picture.
  void load_inside(int width, int height, int left, int top) {
    for (int y = 0; y < height_; ++y) {
      float* to = row(0, y);
      for (int x = 0; x < stride_; ++x) {
        to[x] = top + y >= 0 && top + y < height && left + x >= 0 && left + x < width ? 1.0f : 0.0f;
      }
    }
  }

 private:
  int stride_, height_;
  std::vector<float> data_;
};

/// Squared distances of one row of pixels p to pixels q, less what noise alone would make of them.
void distance_row(const Margin& p, int px, int py, const Margin& q, int qx, int qy, const float* __restrict p_inside,
                  const float* __restrict q_inside, const float* __restrict vp, const float* __restrict vq, float k2,
                  float floor, int width, float* __restrict out) {
  const float *p0 = p.row(0, py) + px, *p1 = p.row(1, py) + px, *p2 = p.row(2, py) + px;
  const float *q0 = q.row(0, qy) + qx, *q1 = q.row(1, qy) + qx, *q2 = q.row(2, qy) + qx;
  for (int x = 0; x < width; ++x) {
    const float a = p0[x] - q0[x], b = p1[x] - q1[x], c = p2[x] - q2[x];
    const float num = (a * a + b * b + c * c) * (1 / 3.0f) - (vp[x] + std::min(vp[x], vq[x]));
    const float den = floor + k2 * (vp[x] + vq[x]);
    out[x] = std::min(num / den, 1e4f) * (p_inside[x] * q_inside[x]);
  }
}

/// weight = exp(-max(0, patch distance, feature distance)), 0 beyond the cutoff.
void weight_row(const float* const* rows, int patch, const float* __restrict feature, const float* __restrict inside,
                int width, float* __restrict sums, float* __restrict out) {
  const int side = 2 * patch + 1, wide = width + 2 * patch;
  for (int x = 0; x < wide; ++x) sums[x] = rows[0][x];
  for (int i = 1; i < side; ++i) {
    const float* __restrict r = rows[i];
    for (int x = 0; x < wide; ++x) sums[x] += r[x];
  }
  for (int x = 0; x < width; ++x) out[x] = sums[x];
  for (int i = 1; i < side; ++i) {
    const float* __restrict s = sums + i;
    for (int x = 0; x < width; ++x) out[x] += s[x];
  }
  const float scale = 1 / float(side * side);
  for (int x = 0; x < width; ++x) {
    const float d = std::max(std::max(out[x] * scale, feature[x]), 0.0f);
    const float w = exp2_fast(-kLog2E * std::min(d, kCutoff));
    out[x] = d < kCutoff ? w * inside[x] : 0.0f;
  }
}

/// What one tile is averaged from, and what came of it.
class Tile {
 public:
  Tile(std::span<const NlMeansFrame> frames, const NlMeansSettings& settings, int x0, int y0)
      : frames_(frames),
        s_(settings),
        width_(frames[0].a->width()),
        height_(frames[0].a->height()),
        x0_(x0),
        y0_(y0),
        halves_(frames[0].b != nullptr),
        features_(frames[0].features ? frames[0].features->channels() : 0),
        reach_(std::max(settings.window, settings.window_around)),
        margin_(reach_ + settings.patch),
        tile_width_(std::min(kTileWidth, width_ - x0)),
        tile_height_(std::min(kTileHeight, height_ - y0)) {}

  void run(NlMeansResult& result) {
    const int stride = kTileWidth + 2 * margin_, rows = kTileHeight + 2 * margin_;
    Margin p_a(stride, rows, 3), p_b(stride, rows, halves_ ? 3 : 0), p_v(stride, rows, 1), p_in(stride, rows, 1),
        p_f(stride, rows, features_);
    Margin q_a(stride, rows, 3), q_b(stride, rows, halves_ ? 3 : 0), q_v(stride, rows, 1), q_in(stride, rows, 1),
        q_f(stride, rows, features_);
    load(frames_[0], p_a, p_b, p_v, p_in, p_f);
    set_feature_scales(p_f);

    const int sides = halves_ ? 2 : 1;
    Margin sums(kTileWidth, kTileHeight, 5 * sides);  // three channels, the weights and the largest of them
    const int patch = s_.patch, wide = tile_width_ + 2 * patch, tall = tile_height_ + 2 * patch;
    Margin distance_a(kTileWidth + 2 * patch, kTileHeight + 2 * patch, 1),
        distance_b(kTileWidth + 2 * patch, kTileHeight + 2 * patch, 1);
    std::vector<float> feature(kTileWidth), column(std::size_t(kTileWidth + 2 * patch)), weight(kTileWidth);
    std::vector<const float*> row_pointers(std::size_t(2 * patch + 1));
    const float k2 = s_.k * s_.k;

    for (std::size_t n = 0; n < frames_.size(); ++n) {
      const bool here = n == 0;
      if (!here) load(frames_[n], q_a, q_b, q_v, q_in, q_f);
      const Margin &qa = here ? p_a : q_a, &qb = here ? p_b : q_b, &qv = here ? p_v : q_v, &qin = here ? p_in : q_in,
                   &qf = here ? p_f : q_f;
      const int window = here ? s_.window : s_.window_around;
      for (int dy = -window; dy <= window; ++dy) {
        for (int dx = -window; dx <= window; ++dx) {
          if (here && dx == 0 && dy == 0) continue;
          const int left = margin_ - patch;
          for (int y = 0; y < tall; ++y) {
            const int py = left + y, qy = py + dy;
            const auto distances = [&](const Margin& p, const Margin& q, Margin& out) {
              distance_row(p, left, py, q, left + dx, qy, p_in.row(0, py) + left, qin.row(0, qy) + left + dx,
                           p_v.row(0, py) + left, qv.row(0, qy) + left + dx, k2, s_.floor, wide, out.row(0, y));
            };
            distances(p_a, qa, distance_a);
            if (halves_) distances(p_b, qb, distance_b);
          }
          for (int y = 0; y < tile_height_; ++y) {
            const int py = margin_ + y, qy = py + dy;
            feature_row(p_f, py, qf, margin_ + dx, qy, feature.data());
            const float* inside = qin.row(0, qy) + margin_ + dx;
            for (int side = 0; side < sides; ++side) {
              // Distances of one half are the weights of the other.
              const Margin& distance = side == 0 && halves_ ? distance_b : distance_a;
              for (int i = 0; i < 2 * patch + 1; ++i) row_pointers[std::size_t(i)] = distance.row(0, y + i);
              weight_row(row_pointers.data(), patch, feature.data(), inside, tile_width_, column.data(), weight.data());
              add_row(weight.data(), (side == 0 ? qa : qb), margin_ + dx, qy, sums, 5 * side, y);
            }
          }
        }
      }
    }
    for (int side = 0; side < sides; ++side)
      finish(side == 0 ? p_a : p_b, sums, 5 * side, side == 0 ? result.a : result.b);
  }

 private:
  void load(const NlMeansFrame& f, Margin& a, Margin& b, Margin& v, Margin& inside, Margin& features) const {
    const int left = x0_ - margin_, top = y0_ - margin_;
    a.load(*f.a, left, top);
    if (halves_) b.load(*f.b, left, top);
    v.load(*f.variance, left, top);
    // Of halves each has twice the variance of their mean.
    if (halves_) {
      for (int y = 0; y < kTileHeight + 2 * margin_; ++y) {
        float* row = v.row(0, y);
        for (int x = 0; x < v.stride(); ++x) row[x] *= 2;
      }
    }
    if (f.valid) {
      inside.load(*f.valid, left, top);
    } else {
      inside.load_inside(width_, height_, left, top);
    }
    if (features_ > 0) features.load(*f.features, left, top);
  }

  /// The factor of a squared difference of each channel: features may differ by what they do between neighbours.
  void set_feature_scales(const Margin& f) {
    if (features_ == 0) return;
    scales_ = std::vector<float>(s_.feature_groups.size() * kTileHeight * kTileWidth);
    int channel = 0;
    for (std::size_t g = 0; g < s_.feature_groups.size(); ++g) {
      const int channels = s_.feature_groups[g];
      for (int y = 0; y < tile_height_; ++y) {
        for (int x = 0; x < tile_width_; ++x) {
          float gradient = 0;
          for (int c = channel; c < channel + channels; ++c) {
            const int gx = x0_ + x, gy = y0_ + y;
            const auto at = [&](int i, int j) {
              return f.row(c,
                           margin_ + std::clamp(j, 0, height_ - 1) - y0_)[margin_ + std::clamp(i, 0, width_ - 1) - x0_];
            };
            const float v = at(gx, gy);
            const auto smaller = [&](float before, float after) {
              return std::min((v - before) * (v - before), (after - v) * (after - v)) * 0.25f;
            };
            gradient += smaller(at(gx - 1, gy), at(gx + 1, gy)) + smaller(at(gx, gy - 1), at(gx, gy + 1));
          }
          gradient /= float(channels);
          scale(g, y)[x] =
              1 / (float(channels) * s_.k_feature * s_.k_feature * std::max(s_.feature_floors[g], gradient));
        }
      }
      channel += channels;
    }
  }
  float* scale(std::size_t group, int y) {
    return scales_.data() + (group * kTileHeight + std::size_t(y)) * std::size_t(kTileWidth);
  }

  void feature_row(const Margin& p, int py, const Margin& q, int qx, int qy, float* __restrict out) {
    for (int x = 0; x < tile_width_; ++x) out[x] = 0;
    int channel = 0;
    for (std::size_t g = 0; g < s_.feature_groups.size() && features_ > 0; ++g) {
      const float* __restrict k = scale(g, py - margin_);
      float sums[kTileWidth] = {};
      for (int c = 0; c < s_.feature_groups[g]; ++c, ++channel) {
        const float *fp = p.row(channel, py) + margin_, *fq = q.row(channel, qy) + qx;
        for (int x = 0; x < tile_width_; ++x) {
          const float d = fp[x] - fq[x];
          sums[x] += d * d;
        }
      }
      for (int x = 0; x < tile_width_; ++x) out[x] = std::max(out[x], k[x] * sums[x]);
    }
  }

  void add_row(const float* __restrict w, const Margin& q, int qx, int qy, Margin& sums, int channel, int y) const {
    for (int c = 0; c < 3; ++c) {
      const float* __restrict from = q.row(c, qy) + qx;
      float* __restrict to = sums.row(channel + c, y);
      for (int x = 0; x < tile_width_; ++x) to[x] += w[x] * from[x];
    }
    float* __restrict total = sums.row(channel + 3, y);
    float* __restrict largest = sums.row(channel + 4, y);
    for (int x = 0; x < tile_width_; ++x) total[x] += w[x], largest[x] = std::max(largest[x], w[x]);
  }

  /// A pixel weighs as much as its most like neighbour.
  void finish(const Margin& p, Margin& sums, int channel, Planes& out) const {
    for (int y = 0; y < tile_height_; ++y) {
      const float *total = sums.row(channel + 3, y), *largest = sums.row(channel + 4, y);
      for (int c = 0; c < 3; ++c) {
        const float *sum = sums.row(channel + c, y), *own = p.row(c, margin_ + y) + margin_;
        float* to = out.row(c, y0_ + y) + x0_;
        for (int x = 0; x < tile_width_; ++x) {
          const float w = std::max(largest[x], 1e-3f);
          to[x] = (sum[x] + w * own[x]) / (total[x] + w);
        }
      }
    }
  }

  std::span<const NlMeansFrame> frames_;
  const NlMeansSettings& s_;
  int width_, height_, x0_, y0_;
  bool halves_;
  int features_, reach_, margin_, tile_width_, tile_height_;
  std::vector<float> scales_;
};

}  // namespace

bool is_on_trial(int x, int y, int every) { return (x / kTileWidth + 2 * (y / kTileHeight)) % every == 0; }

NlMeansResult nl_means(std::span<const NlMeansFrame> frames, const NlMeansSettings& settings) {
  const int width = frames[0].a->width(), height = frames[0].a->height();
  NlMeansResult result{Planes(width, height, 3), frames[0].b ? Planes(width, height, 3) : Planes()};
  const int across = (width + kTileWidth - 1) / kTileWidth, down = (height + kTileHeight - 1) / kTileHeight;
  parallel_for(0, std::int64_t(across) * down, [&](std::int64_t i) {
    const int x = int(i % across) * kTileWidth, y = int(i / across) * kTileHeight;
    if (is_on_trial(x, y, settings.every)) Tile(frames, settings, x, y).run(result);
  });
  return result;
}

}  // namespace tempera::denoise
