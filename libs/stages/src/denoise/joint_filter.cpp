// SPDX-License-Identifier: Apache-2.0
#include "denoise/joint_filter.h"

#include <algorithm>
#include <cmath>

#include "tempera/core/error.h"
#include "tempera/core/fast_math.h"

namespace tempera::denoise {

namespace {

constexpr int kTileWidth = 64, kTileHeight = 32;
constexpr float kLeastCentre = 1e-3f;  ///< weight of a pixel that nothing is like

/// exp(-max(0, d))
inline float fading(float d) { return exp2_fast(-1.44269504f * std::clamp(d, 0.0f, 80.0f)); }

/// What the weights by features divide by, and the noise of each: one channel per feature.
struct FeatureScales {
  Planes variance;  ///< mean of the channels
  Planes spread;    ///< squared difference that is to be expected: of noise, or between neighbours
};

FeatureScales feature_scales(const JointFrame& frame, const std::vector<int>& groups) {
  if (!frame.features || groups.empty()) return {};
  const Planes& f = *frame.features;
  const int width = f.width(), height = f.height();
  FeatureScales out{Planes(width, height, int(groups.size())), Planes(width, height, int(groups.size()))};
  int channel = 0;
  for (int g = 0; g < std::ssize(groups); channel += groups[std::size_t(g++)]) {
    const int n = groups[std::size_t(g)];
    for_rows(height, [&](int y) {
      float *variance = out.variance.row(g, y), *spread = out.spread.row(g, y);
      for (int c = channel; c < channel + n; ++c) {
        const float *here = f.row(c, y), *up = f.row(c, std::max(y - 1, 0)),
                    *down = f.row(c, std::min(y + 1, height - 1));
        const float* v = frame.feature_variance ? frame.feature_variance->row(c, y) : nullptr;
        for (int x = 0; x < width; ++x) {
          // Of the steps to both neighbours the smaller one, so that pixels beside an edge do not blur over it.
          const auto smaller = [&](float before, float after) {
            const float a = here[x] - before, b = after - here[x];
            return 0.25f * std::min(a * a, b * b);
          };
          spread[x] += (smaller(here[std::max(x - 1, 0)], here[std::min(x + 1, width - 1)]) + smaller(up[x], down[x])) /
                       float(n);
          if (v) variance[x] += v[x] / float(n);
        }
      }
      for (int x = 0; x < width; ++x) spread[x] = std::max(spread[x], variance[x]);
    });
  }
  return out;
}

/// A tile with a margin, in memory of its own.
class Buffer {
 public:
  Buffer(int width, int height, int channels = 1)
      : width_(width), height_(height), data_(std::size_t(width) * std::size_t(height) * std::size_t(channels)) {}
  float* row(int y, int c = 0) { return data_.data() + std::size_t(c * height_ + y) * std::size_t(width_); }
  int width() const { return width_; }
  int height() const { return height_; }
  void fill(float value) { std::fill(data_.begin(), data_.end(), value); }

 private:
  int width_, height_;
  std::vector<float> data_;
};

/// out = sums of `in` over (2 radius + 1)^2, without the outermost `inset` rows and columns. Pre: inset >= radius.
void box_sum(Buffer& in, Buffer& rows, Buffer& out, int radius, int inset) {
  const int width = in.width(), height = in.height();
  for (int y = inset - radius; y < height - inset + radius; ++y) {
    float* __restrict to = rows.row(y) + inset, *from = in.row(y) + inset - radius;
    const int n = width - 2 * inset;
    std::copy_n(from, n, to);
    for (int i = 1; i <= 2 * radius; ++i) {
      const float* __restrict f = from + i;
      for (int x = 0; x < n; ++x) to[x] += f[x];
    }
  }
  for (int y = inset; y < height - inset; ++y) {
    float* __restrict to = out.row(y) + inset;
    const int n = width - 2 * inset;
    std::copy_n(rows.row(y - radius) + inset, n, to);
    for (int i = 1; i <= 2 * radius; ++i) {
      const float* __restrict f = rows.row(y - radius + i) + inset;
      for (int x = 0; x < n; ++x) to[x] += f[x];
    }
  }
}

class Tile {
 public:
  Tile(std::span<const JointFrame> frames, std::span<const FeatureScales> scales, const JointSettings& settings,
       int patch, int x0, int y0)
      : frames_(frames),
        scales_(scales),
        s_(settings),
        width_(frames[0].guide->width()),
        height_(frames[0].guide->height()),
        channels_(frames[0].guide->channels()),
        x0_(x0),
        y0_(y0),
        margin_(std::max(2 * patch - 1, 0)),
        tile_width_(std::min(kTileWidth, width_ - x0)),
        tile_height_(std::min(kTileHeight, height_ - y0)),
        distance_(tile_width_ + 2 * margin_, tile_height_ + 2 * margin_),
        there_(distance_),
        rows_(distance_),
        sum_(distance_),
        count_(distance_),
        color_(distance_),
        active_(distance_),
        extended_(distance_),
        feature_(tile_width_, tile_height_),
        weight_(tile_width_, tile_height_),
        slope_(tile_width_, tile_height_) {}

  int x0() const { return x0_; }
  int y0() const { return y0_; }
  int tile_width() const { return tile_width_; }
  int tile_height() const { return tile_height_; }
  const float* weights(int y) { return weight_.row(y); }

  /// The distances of all pairs of pixels, (dx, dy) apart, of the first frame and frame `n`.
  void compare(std::size_t n, int dx, int dy) {
    const JointFrame &p = frames_[0], &q = frames_[n];
    const float k2 = s_.k_color * s_.k_color, scale = 1 / float(channels_);
    const auto within = [this](int x, int y) { return x >= 0 && y >= 0 && x < width_ && y < height_; };
    const int right = x0_ + tile_width_ + margin_ - 1, bottom = y0_ + tile_height_ + margin_ - 1;
    whole_ = !q.valid && within(x0_ - margin_, y0_ - margin_) && within(right, bottom) &&
             within(x0_ - margin_ + dx, y0_ - margin_ + dy) && within(right + dx, bottom + dy);
    for (int j = 0; j < distance_.height(); ++j) {
      const int y = y0_ - margin_ + j, left = x0_ - margin_;
      float* __restrict d = distance_.row(j), * __restrict ok = there_.row(j);
      std::fill_n(d, distance_.width(), 0.0f), std::fill_n(ok, distance_.width(), 0.0f);
      if (y < 0 || y >= height_ || y + dy < 0 || y + dy >= height_) continue;
      const int first = std::max({left, 0, -dx}), last = std::min({left + distance_.width(), width_, width_ - dx});
      const float* valid = q.valid ? q.valid->row(0, y + dy) + dx : nullptr;
      for (int x = first; x < last; ++x) ok[x - left] = valid ? valid[x] : 1.0f;
      // [Rousselle 2013]
      for (int c = 0; c < channels_; ++c) {
        const float *gp = p.guide->row(c, y), *gq = q.guide->row(c, y + dy) + dx;
        const float *vp = p.variance->row(c, y), *vq = q.variance->row(c, y + dy) + dx;
        for (int x = first; x < last; ++x) {
          const float u = gp[x] - gq[x], num = u * u - (vp[x] + std::min(vp[x], vq[x]));
          d[x - left] += ok[x - left] * scale * num / (s_.floor + k2 * (vp[x] + vq[x]));
        }
      }
    }
  }

  /// Weights of the pairs for one parameter set, and the part of them that changes with the pixel's own color.
  void weigh(std::size_t n, int dx, int dy, const JointFilter& filter) {
    const int f = filter.patch, reach = std::max(f - 1, 0), inset = margin_ - reach;
    if (filter.color) {
      box_sum(distance_, rows_, sum_, f, inset), count_pairs(count_, f, inset);
      for (int j = inset; j < distance_.height() - inset; ++j) {
        const float *d = sum_.row(j), *count = count_.row(j), *ok = there_.row(j);
        float* __restrict w = color_.row(j), * __restrict active = active_.row(j);
        for (int i = inset; i < distance_.width() - inset; ++i) {
          w[i] = ok[i] * fading(d[i] / std::max(count[i], 1.0f));
          active[i] = d[i] > 0 ? w[i] : 0.0f;
        }
      }
      // A weight is the mean of those by all patches that hold both pixels at the same place.
      if (reach > 0) {
        box_sum(color_, rows_, sum_, reach, margin_), box_sum(active_, rows_, extended_, reach, margin_);
        std::swap(active_, extended_);
        count_pairs(extended_, reach, margin_);
      }
    }
    features(n, dx, dy, filter.tau);
    for (int y = 0; y < tile_height_; ++y) {
      const float *ok = there_.row(margin_ + y) + margin_, *feature = feature_.row(y);
      const float* color = (reach > 0 ? sum_ : color_).row(margin_ + y) + margin_;
      const float *pairs = extended_.row(margin_ + y) + margin_, *active = active_.row(margin_ + y) + margin_;
      const float* count = count_.row(margin_ + y) + margin_;
      float* __restrict w = weight_.row(y), * __restrict slope = slope_.row(y);
      for (int x = 0; x < tile_width_; ++x) {
        const float all = filter.color && reach > 0 ? 1 / std::max(pairs[x], 1.0f) : 1.0f;
        const float by_color = filter.color ? color[x] * all : 1.0f;
        w[x] = ok[x] * std::min(by_color, feature[x]);  // [Rousselle 2013]
        const bool changes = filter.color && by_color < feature[x];
        slope[x] = changes ? ok[x] * active[x] * all / std::max(count[x], 1.0f) : 0.0f;
      }
    }
  }

  void run(std::span<const JointFilter> filters, std::span<JointResult> results) {
    const int values = frames_[0].values->channels(), slopes = s_.derivative ? channels_ : 0;
    // Of each filter: values, weights, their squares, the largest; of the derivative: filtered guide, slopes times
    // guide, slopes, those of the largest weight.
    std::vector<Buffer> sums(filters.size(), Buffer(tile_width_, tile_height_, values + 3 + 4 * slopes));
    for (std::size_t n = 0; n < frames_.size(); ++n) {
      for (int dy = -s_.window; dy <= s_.window; ++dy) {
        for (int dx = -s_.window; dx <= s_.window; ++dx) {
          if (n == 0 && dx == 0 && dy == 0) continue;
          if (x0_ + tile_width_ + dx <= 0 || x0_ + dx >= width_ || y0_ + tile_height_ + dy <= 0 || y0_ + dy >= height_)
            continue;
          compare(n, dx, dy);
          for (std::size_t k = 0; k < filters.size(); ++k) {
            weigh(n, dx, dy, filters[k]);
            add(frames_[n], dx, dy, sums[k]);
          }
        }
      }
    }
    for (std::size_t k = 0; k < filters.size(); ++k) finish(sums[k], results[k]);
  }

 private:
  /// How many pairs of each patch are there.
  void count_pairs(Buffer& out, int radius, int inset) {
    if (whole_) {
      out.fill(float((2 * radius + 1) * (2 * radius + 1)));
    } else {
      box_sum(there_, rows_, out, radius, inset);
    }
  }

  /// Weights by features. [Rousselle 2013]
  void features(std::size_t n, int dx, int dy, float tau) {
    const JointFrame &p = frames_[0], &q = frames_[n];
    const int first = std::max(x0_, -dx), last = std::min(x0_ + tile_width_, width_ - dx);
    for (int y = y0_; y < y0_ + tile_height_; ++y) {
      float* __restrict w = feature_.row(y - y0_);
      std::fill_n(w, tile_width_, 0.0f);
      if (y + dy < 0 || y + dy >= height_ || !p.features) {
        std::fill_n(w, tile_width_, 1.0f);
        continue;
      }
      int channel = 0;
      for (int g = 0; g < std::ssize(s_.feature_groups); ++g) {
        const int channels = s_.feature_groups[std::size_t(g)];
        float sum[kTileWidth] = {};
        for (int c = channel; c < channel + channels; ++c) {
          const float *fp = p.features->row(c, y), *fq = q.features->row(c, y + dy) + dx;
          for (int x = first; x < last; ++x) {
            const float d = fp[x] - fq[x];
            sum[x - x0_] += d * d;
          }
        }
        channel += channels;
        const float *vp = scales_[0].variance.row(g, y), *vq = scales_[n].variance.row(g, y + dy) + dx;
        const float* spread = scales_[0].spread.row(g, y);
        for (int x = first; x < last; ++x) {
          const float num = sum[x - x0_] / float(channels) - (vp[x] + std::min(vp[x], vq[x]));
          w[x - x0_] = std::max(w[x - x0_], num / (s_.k_feature * s_.k_feature * std::max(tau, spread[x])));
        }
      }
      for (int x = 0; x < tile_width_; ++x) w[x] = fading(w[x]);
    }
  }

  void add(const JointFrame& q, int dx, int dy, Buffer& sums) {
    const int values = q.values->channels();
    const int first = std::max(x0_, -dx) - x0_, last = std::min(x0_ + tile_width_, width_ - dx) - x0_;
    for (int y = 0; y < tile_height_; ++y) {
      const int qy = y0_ + y + dy;
      if (qy < 0 || qy >= height_) continue;
      const float* __restrict w = weight_.row(y);
      for (int c = 0; c < values; ++c) {
        const float* from = q.values->row(c, qy) + x0_ + dx;
        float* __restrict to = sums.row(y, c);
        for (int x = first; x < last; ++x) to[x] += w[x] * from[x];
      }
      float* __restrict total = sums.row(y, values);
      float* __restrict squares = sums.row(y, values + 1);
      float* __restrict largest = sums.row(y, values + 2);
      for (int c = 0; s_.derivative && c < channels_; ++c) {
        // Of exp(-D^2), D^2 the mean over the patch and its channels, by the pixel in the middle of the patch.
        const float k2 = s_.k_color * s_.k_color, scale = -2 / float(channels_);
        const float *gp = frames_[0].guide->row(c, y0_ + y) + x0_, *gq = q.guide->row(c, qy) + x0_ + dx;
        const float *vp = frames_[0].variance->row(c, y0_ + y) + x0_, *vq = q.variance->row(c, qy) + x0_ + dx;
        const float* __restrict slope = slope_.row(y);
        const int at = values + 3 + 4 * c;
        float* __restrict guide = sums.row(y, at);
        float* __restrict product = sums.row(y, at + 1);
        float* __restrict sum = sums.row(y, at + 2);
        float* __restrict of_largest = sums.row(y, at + 3);
        for (int x = first; x < last; ++x) {
          const float d = scale * slope[x] * (gp[x] - gq[x]) / (s_.floor + k2 * (vp[x] + vq[x]));
          guide[x] += w[x] * gq[x], product[x] += d * gq[x], sum[x] += d;
          of_largest[x] = w[x] > largest[x] ? d : of_largest[x];
        }
      }
      for (int x = first; x < last; ++x) {
        total[x] += w[x], squares[x] += w[x] * w[x], largest[x] = std::max(largest[x], w[x]);
      }
    }
  }

  /// A pixel weighs as much as its most like neighbour.
  void finish(Buffer& sums, JointResult& out) const {
    const int values = frames_[0].values->channels();
    for (int y = 0; y < tile_height_; ++y) {
      const float *total = sums.row(y, values), *squares = sums.row(y, values + 1), *largest = sums.row(y, values + 2);
      const auto own = [&](int x) { return std::max(largest[x], kLeastCentre); };
      for (int c = 0; c < values; ++c) {
        const float *sum = sums.row(y, c), *here = frames_[0].values->row(c, y0_ + y) + x0_;
        float* to = out.values.row(c, y0_ + y) + x0_;
        for (int x = 0; x < tile_width_; ++x) to[x] = (sum[x] + own(x) * here[x]) / (total[x] + own(x));
      }
      float* gain = out.gain.row(0, y0_ + y) + x0_;
      for (int x = 0; x < tile_width_; ++x) {
        const float sum = total[x] + own(x);
        gain[x] = (squares[x] + own(x) * own(x)) / (sum * sum);
      }
      for (int c = 0; s_.derivative && c < channels_; ++c) {
        const int at = values + 3 + 4 * c;
        const float *guide = sums.row(y, at), *product = sums.row(y, at + 1), *sum = sums.row(y, at + 2),
                    *of_largest = sums.row(y, at + 3), *here = frames_[0].guide->row(c, y0_ + y) + x0_;
        float* to = out.derivative.row(c, y0_ + y) + x0_;
        for (int x = 0; x < tile_width_; ++x) {
          const float all = total[x] + own(x), filtered = (guide[x] + own(x) * here[x]) / all;
          const float own_slope = largest[x] > kLeastCentre ? of_largest[x] : 0.0f;
          to[x] = (product[x] + own_slope * here[x] + own(x) - filtered * (sum[x] + own_slope)) / all;
        }
      }
    }
  }

  std::span<const JointFrame> frames_;
  std::span<const FeatureScales> scales_;
  const JointSettings& s_;
  int width_, height_, channels_, x0_, y0_, margin_, tile_width_, tile_height_;
  Buffer distance_, there_, rows_, sum_, count_, color_, active_, extended_;  ///< with the margin
  Buffer feature_, weight_, slope_;                                           ///< without
  bool whole_ = false;                                                        ///< whether all pairs are there
};

/// Calls body(tile) for all tiles, in parallel.
template <class F>
void for_tiles(std::span<const JointFrame> frames, const JointSettings& settings, int patch, const F& body) {
  std::vector<FeatureScales> scales;
  for (const JointFrame& f : frames) scales.push_back(feature_scales(f, settings.feature_groups));
  const int width = frames[0].guide->width(), height = frames[0].guide->height();
  const int across = (width + kTileWidth - 1) / kTileWidth, down = (height + kTileHeight - 1) / kTileHeight;
  parallel_for(0, std::int64_t(across) * down, [&](std::int64_t i) {
    Tile tile(frames, scales, settings, patch, int(i % across) * kTileWidth, int(i / across) * kTileHeight);
    body(tile);
  });
}

int largest_patch(std::span<const JointFilter> filters) {
  int patch = 0;
  for (const JointFilter& f : filters) patch = std::max(patch, f.patch);
  return patch;
}

}  // namespace

std::vector<JointResult> joint_filter(std::span<const JointFrame> frames, std::span<const JointFilter> filters,
                                      const JointSettings& settings) {
  const int width = frames[0].guide->width(), height = frames[0].guide->height();
  std::vector<JointResult> results(filters.size());
  for (JointResult& r : results) {
    r = {Planes(width, height, frames[0].values->channels()), Planes(width, height, 1),
         settings.derivative ? Planes(width, height, frames[0].guide->channels()) : Planes()};
  }
  for_tiles(frames, settings, largest_patch(filters), [&](Tile& tile) { tile.run(filters, results); });
  return results;
}

Planes joint_weights(const JointFrame& frame, const JointFilter& filter, const JointSettings& settings, int dx,
                     int dy) {
  Planes out(frame.guide->width(), frame.guide->height(), 1);
  for_tiles(std::span(&frame, 1), settings, filter.patch, [&](Tile& tile) {
    tile.compare(0, dx, dy), tile.weigh(0, dx, dy, filter);
    for (int y = 0; y < tile.tile_height(); ++y)
      std::copy_n(tile.weights(y), tile.tile_width(), out.row(0, tile.y0() + y) + tile.x0());
  });
  return out;
}

}  // namespace tempera::denoise
