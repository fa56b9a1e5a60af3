// SPDX-License-Identifier: Apache-2.0
#pragma once
// Pictures as planes of single channels, which is what filters loop over, and the loops that they share. Private to the
// denoiser.
#include <bit>
#include <cstdint>
#include <functional>
#include <vector>

#include "tempera/core/parallel.h"
#include "tempera/frames/image.h"

namespace tempera::denoise {

/// Channels one after another, each [height, width].
class Planes {
 public:
  Planes() = default;
  Planes(int width, int height, int channels, float fill = 0)
      : width_(width),
        height_(height),
        channels_(channels),
        data_(std::size_t(width) * std::size_t(height) * std::size_t(channels), fill) {}
  /// The first `channels` channels of an image. Pre: it has that many.
  Planes(const Image& image, int channels);

  int width() const { return width_; }
  int height() const { return height_; }
  int channels() const { return channels_; }
  bool empty() const { return data_.empty(); }
  std::size_t pixels() const { return std::size_t(width_) * std::size_t(height_); }
  float* plane(int c) { return data_.data() + std::size_t(c) * pixels(); }
  const float* plane(int c) const { return data_.data() + std::size_t(c) * pixels(); }
  float* row(int c, int y) { return plane(c) + std::size_t(y) * std::size_t(width_); }
  const float* row(int c, int y) const { return plane(c) + std::size_t(y) * std::size_t(width_); }
  std::vector<float>& values() { return data_; }
  const std::vector<float>& values() const { return data_; }
  /// Interleaved again.
  Image image() const;

 private:
  int width_ = 0, height_ = 0, channels_ = 0;
  std::vector<float> data_;
};

/// The same in 16 bits a value, for planes that wait: a sign, 6 bits of exponent and 9 of mantissa. The error is below
/// 2^-10 of a value; what is below 2^-32 is 0, above 2^32 that. Planes of zeros alone take no room.
class PackedPlanes {
 public:
  PackedPlanes() = default;
  explicit PackedPlanes(const Planes& planes);
  int width() const { return width_; }
  int height() const { return height_; }
  int channels() const { return int(data_.size()); }
  bool empty() const { return data_.empty(); }
  bool is_zero() const;
  float at(int c, int y, int x) const {
    const std::vector<std::uint16_t>& plane = data_[std::size_t(c)];
    return plane.empty() ? 0.0f : decode(plane[std::size_t(y) * std::size_t(width_) + std::size_t(x)]);
  }
  void decode_row(int c, int y, float* to) const;
  Planes planes() const;

 private:
  static float decode(std::uint32_t code) {
    const std::uint32_t size = code & 0x7fffu;
    return std::bit_cast<float>(size == 0 ? 0u : (code & 0x8000u) << 16 | ((size << 14) + kLeast));
  }
  static constexpr std::uint32_t kLeast = 95u << 23;  ///< 2^-32 as bits of a float
  int width_ = 0, height_ = 0;
  std::vector<std::vector<std::uint16_t>> data_;  ///< by channel
};

/// Calls body(y) for all rows, in parallel.
void for_rows(int height, const std::function<void(int y)>& body);

/// Sets each value v of channel c at (x, y) to f(c, y, x, v), rows in parallel.
template <class F>
void for_values(Planes& out, const F& f) {
  for (int c = 0; c < out.channels(); ++c) {
    for_rows(out.height(), [&](int y) {
      float* to = out.row(c, y);
      for (int x = 0; x < out.width(); ++x) to[x] = f(c, y, x, to[x]);
    });
  }
}

/// Mean over (2 radius + 1)^2 pixels, as far as they are in the picture, of each channel. Result: the same bits for any
/// number of threads.
Planes box_mean(const Planes& in, int radius);

/// The mean over the channels of (a - b)^2 / 4, averaged over (2 radius + 1)^2 pixels: the variance of (a + b) / 2,
/// where a and b are independent.
Planes half_variance(const Planes& a, const Planes& b, int radius);

/// The variance of noise that neighbours do not share, where nothing else tells it: of what a pixel differs from the mean
/// of its four neighbours, averaged over channels and (2 radius + 1)^2 pixels. Edges and textures add to it.
Planes apparent_variance(const Planes& in, int radius);

/// Squared radiance, divided like the light, that no eye and no display could tell from none.
float noise_floor(const Planes& light);

inline float luminance(float r, float g, float b) { return 0.2126f * r + 0.7152f * g + 0.0722f * b; }

}  // namespace tempera::denoise
