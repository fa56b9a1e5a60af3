// SPDX-License-Identifier: Apache-2.0
#include "denoise/planes.h"

#include <algorithm>

namespace tempera::denoise {

namespace {

constexpr int kBlock = 32;  ///< rows that one task sums up: a constant, as rounding depends on it

/// Means along a row.
void box_row(const float* in, float* out, int width, int radius) {
  double sum = 0;
  for (int x = 0; x < std::min(radius, width); ++x) sum += double(in[x]);
  for (int x = 0; x < width; ++x) {
    if (x + radius < width) sum += double(in[x + radius]);
    if (x - radius - 1 >= 0) sum -= double(in[x - radius - 1]);
    const int count = std::min(x + radius, width - 1) - std::max(x - radius, 0) + 1;
    out[x] = float(sum / count);
  }
}

}  // namespace

Planes::Planes(const Image& image, int channels) : Planes(image.width(), image.height(), channels) {
  const int stride = image.channels();
  for_rows(height_, [&](int y) {
    const float* from = image.row(y);
    for (int c = 0; c < channels_; ++c) {
      float* to = row(c, y);
      for (int x = 0; x < width_; ++x) to[x] = from[std::size_t(x) * std::size_t(stride) + std::size_t(c)];
    }
  });
}

Image Planes::image() const {
  Image out(width_, height_, channels_);
  for_rows(height_, [&](int y) {
    float* to = out.row(y);
    for (int c = 0; c < channels_; ++c) {
      const float* from = row(c, y);
      for (int x = 0; x < width_; ++x) to[std::size_t(x) * std::size_t(channels_) + std::size_t(c)] = from[x];
    }
  });
  return out;
}

PackedPlanes::PackedPlanes(const Planes& planes)
    : width_(planes.width()), height_(planes.height()), data_(std::size_t(planes.channels())) {
  parallel_for(0, planes.channels(), [&](std::int64_t c) {
    const float* from = planes.plane(int(c));
    const std::size_t n = planes.pixels();
    if (std::all_of(from, from + n, [](float v) { return v == 0; })) return;
    std::vector<std::uint16_t>& to = data_[std::size_t(c)];
    to.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
      const std::uint32_t bits = std::bit_cast<std::uint32_t>(from[i]);
      const std::int32_t size = std::int32_t((bits & 0x7fffffffu) + 0x2000u) - std::int32_t(kLeast);
      to[i] = std::uint16_t(std::clamp(size >> 14, 0, 0x7fff) | std::int32_t(bits >> 31 << 15));
    }
  });
}

bool PackedPlanes::is_zero() const {
  return std::all_of(data_.begin(), data_.end(), [](const auto& plane) { return plane.empty(); });
}

void PackedPlanes::decode_row(int c, int y, float* to) const {
  const std::vector<std::uint16_t>& plane = data_[std::size_t(c)];
  if (plane.empty()) {
    std::fill_n(to, width_, 0.0f);
    return;
  }
  const std::uint16_t* from = plane.data() + std::size_t(y) * std::size_t(width_);
  for (int x = 0; x < width_; ++x) to[x] = decode(from[x]);
}

Planes PackedPlanes::planes() const {
  Planes out(width_, height_, channels());
  for (int c = 0; c < channels(); ++c) {
    if (!data_[std::size_t(c)].empty()) for_rows(height_, [&](int y) { decode_row(c, y, out.row(c, y)); });
  }
  return out;
}

void for_rows(int height, const std::function<void(int y)>& body) {
  parallel_for(
      0, height, [&](std::int64_t y) { body(int(y)); }, 8);
}

Planes box_mean(const Planes& in, int radius) {
  const int width = in.width(), height = in.height();
  Planes rows(width, height, in.channels()), out(width, height, in.channels());
  const int blocks = (height + kBlock - 1) / kBlock;
  for (int c = 0; c < in.channels(); ++c) {
    for_rows(height, [&](int y) { box_row(in.row(c, y), rows.row(c, y), width, radius); });
    parallel_for(0, blocks, [&](std::int64_t block) {
      const int begin = int(block) * kBlock, end = std::min(begin + kBlock, height);
      std::vector<double> sum(std::size_t(width), 0.0);
      for (int y = std::max(begin - radius, 0); y < std::min(begin + radius, height); ++y) {
        const float* from = rows.row(c, y);
        for (int x = 0; x < width; ++x) sum[std::size_t(x)] += double(from[x]);
      }
      for (int y = begin; y < end; ++y) {
        if (y + radius < height) {
          const float* from = rows.row(c, y + radius);
          for (int x = 0; x < width; ++x) sum[std::size_t(x)] += double(from[x]);
        }
        const int count = std::min(y + radius, height - 1) - std::max(y - radius, 0) + 1;
        float* to = out.row(c, y);
        for (int x = 0; x < width; ++x) to[x] = float(sum[std::size_t(x)] / count);
        if (y - radius >= 0) {
          const float* from = rows.row(c, y - radius);
          for (int x = 0; x < width; ++x) sum[std::size_t(x)] -= double(from[x]);
        }
      }
    });
  }
  return out;
}

Planes half_variance(const Planes& a, const Planes& b, int radius) {
  Planes raw(a.width(), a.height(), 1);
  for_rows(a.height(), [&](int y) {
    float* to = raw.row(0, y);
    for (int c = 0; c < a.channels(); ++c) {
      const float *pa = a.row(c, y), *pb = b.row(c, y);
      for (int x = 0; x < a.width(); ++x) {
        const float d = pa[x] - pb[x];
        to[x] += d * d;
      }
    }
    for (int x = 0; x < a.width(); ++x) to[x] /= float(4 * a.channels());
  });
  return box_mean(raw, radius);
}

Planes apparent_variance(const Planes& in, int radius) {
  const int width = in.width(), height = in.height();
  Planes raw(width, height, 1);
  for_rows(height, [&](int y) {
    float* to = raw.row(0, y);
    for (int c = 0; c < in.channels(); ++c) {
      const float *up = in.row(c, std::max(y - 1, 0)), *down = in.row(c, std::min(y + 1, height - 1)),
                  *here = in.row(c, y);
      for (int x = 0; x < width; ++x) {
        const float around = 0.25f * (up[x] + down[x] + here[std::max(x - 1, 0)] + here[std::min(x + 1, width - 1)]);
        const float d = here[x] - around;
        to[x] += d * d / (1.25f * float(in.channels()));
      }
    }
  });
  return box_mean(raw, radius);
}

float noise_floor(const Planes& light) {
  double sum = 0;
  for (const float v : light.values()) sum += double(v);
  const double mean = sum / double(std::max<std::size_t>(light.values().size(), 1));
  return float(1e-8 * mean * mean + 1e-30);
}

}  // namespace tempera::denoise
