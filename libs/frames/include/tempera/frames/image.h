// SPDX-License-Identifier: Apache-2.0
#pragma once
// An image in memory: interleaved float32, [height, width, channels], row 0 on top. It knows nothing of color spaces or
// file formats; what its channels mean is said by the LayerDesc beside it.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "tempera/core/error.h"
#include "tempera/core/vec.h"

namespace tempera {

/// Pixel (x, y) covers [x, x+1) x [y, y+1) with its center at +0.5. Accessors do not check their arguments in release
/// builds. Threads: concurrent writes to different pixels are safe.
class Image {
 public:
  Image() = default;
  /// All values `fill`. Pre: sizes >= 0.
  Image(int width, int height, int channels, float fill = 0)
      : width_(width), height_(height), channels_(channels), data_(std::size_t(width) * height * channels, fill) {}

  int width() const { return width_; }
  int height() const { return height_; }
  int channels() const { return channels_; }
  bool empty() const { return data_.empty(); }
  /// Number of pixels.
  std::int64_t pixels() const { return std::int64_t(width_) * height_; }
  std::span<float> values() { return data_; }
  std::span<const float> values() const { return data_; }

  /// The channels of one pixel, and the pixels of one row: [width, channels].
  float* pixel(int x, int y) { return data_.data() + offset(x, y); }
  const float* pixel(int x, int y) const { return data_.data() + offset(x, y); }
  float* row(int y) { return data_.data() + row_begin(y); }
  const float* row(int y) const { return data_.data() + row_begin(y); }

  float& at(int x, int y, int c = 0) { return data_[offset(x, y) + c]; }
  float at(int x, int y, int c = 0) const { return data_[offset(x, y) + c]; }
  /// First three channels; a one- or two-channel image gives its first channel as gray.
  Rgb rgb(int x, int y) const {
    const float* p = pixel(x, y);
    return channels_ >= 3 ? Rgb{p[0], p[1], p[2]} : Rgb(p[0]);
  }
  void set_rgb(int x, int y, const Rgb& c) {
    TEMPERA_ASSERT(channels_ >= 3);
    float* p = pixel(x, y);
    p[0] = c.r, p[1] = c.g, p[2] = c.b;
  }
  Vec2f vec2(int x, int y) const {
    TEMPERA_ASSERT(channels_ >= 2);
    const float* p = pixel(x, y);
    return {p[0], p[1]};
  }
  Vec3f vec3(int x, int y) const {
    TEMPERA_ASSERT(channels_ >= 3);
    const float* p = pixel(x, y);
    return {p[0], p[1], p[2]};
  }
  void set_vec3(int x, int y, const Vec3f& v) { set_rgb(x, y, {v.x, v.y, v.z}); }

  /// Whether the position (pixels) lies on the image.
  bool contains(const Vec2f& p) const { return p.x >= 0 && p.y >= 0 && p.x < float(width_) && p.y < float(height_); }
  /// Bilinear interpolation of channel `c` between pixel centers at position `p` (pixels); positions are clamped to the
  /// image, one that is not finite gives the first pixel. Pre: the image is not empty.
  float bilinear(const Vec2f& p, int c = 0) const {
    const Corners k = corners(p);
    return mix(k, k.p00[c], k.p10[c], k.p01[c], k.p11[c]);
  }
  /// As bilinear, for the first three channels.
  Rgb rgb_bilinear(const Vec2f& p) const {
    const Corners k = corners(p);
    if (channels_ < 3) return Rgb(mix(k, k.p00[0], k.p10[0], k.p01[0], k.p11[0]));
    Rgb r;
    for (int c = 0; c < 3; ++c) r[c] = mix(k, k.p00[c], k.p10[c], k.p01[c], k.p11[c]);
    return r;
  }

  /// Same size and the same values by ==, so that NaN differs from itself.
  bool operator==(const Image&) const = default;

 private:
  struct Corners {
    const float *p00, *p10, *p01, *p11;
    float fx, fy;
  };
  std::size_t offset(int x, int y) const {
    TEMPERA_ASSERT(x >= 0 && y >= 0 && x < width_ && y < height_);
    return (std::size_t(y) * width_ + x) * channels_;
  }
  std::size_t row_begin(int y) const { return std::size_t(y) * width_ * channels_; }
  static float mix(const Corners& k, float a, float b, float c, float d) {
    return (a * (1 - k.fx) + b * k.fx) * (1 - k.fy) + (c * (1 - k.fx) + d * k.fx) * k.fy;
  }
  Corners corners(const Vec2f& p) const {
    // max/min in this order send NaN to 0.
    const float x = std::min(std::max(0.0f, p.x - 0.5f), float(width_ - 1));
    const float y = std::min(std::max(0.0f, p.y - 0.5f), float(height_ - 1));
    const int x0 = int(x), y0 = int(y), x1 = std::min(x0 + 1, width_ - 1), y1 = std::min(y0 + 1, height_ - 1);
    return {pixel(x0, y0), pixel(x1, y0), pixel(x0, y1), pixel(x1, y1), x - float(x0), y - float(y0)};
  }

  int width_ = 0, height_ = 0, channels_ = 0;
  std::vector<float> data_;
};

}  // namespace tempera
