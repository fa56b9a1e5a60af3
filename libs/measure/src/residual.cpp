// SPDX-License-Identifier: Apache-2.0
#include "residual.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <type_traits>

#include "motion.h"
#include "tempera/core/parallel.h"
#include "tempera/core/random.h"

namespace tempera {
namespace {

constexpr int kBlock = 512;  ///< pixels a task: their series fit in the cache

constexpr float kLost = std::numeric_limits<float>::quiet_NaN(), kSteps = 32767;

template <class Stored>
Stored stored(float residual) {
  if constexpr (std::is_same_v<Stored, float>) {
    return residual;
  } else {  // of what is displayed, which is finite
    return Stored(std::lround(std::clamp(residual, -1.0f, 1.0f) * kSteps));
  }
}
float restored(float v) { return v; }
float restored(std::int16_t v) { return float(v) / kSteps; }

int blocks(int pixels) { return (pixels + kBlock - 1) / kBlock; }

/// Calls body(block, begin, end) for the blocks of [0, pixels), in any order, on many threads.
template <class F>
void for_each_block(int pixels, const F& body) {
  parallel_rows(0, blocks(pixels),
                [&](int block) { body(block, block * kBlock, std::min((block + 1) * kBlock, pixels)); });
}

}  // namespace

Segments plan_segments(int frames) {
  Segments s;
  if (frames < kMinSpectrumFrames) return s;
  // n segments that overlap by half cover (n + 1) / 2 of their length.
  int count = 1;
  while (frames * 2 > kMaxSegmentFrames * (count + 1)) ++count;
  s.length = frames * 2 / (count + 1);
  for (int i = 0; i < count; ++i) {
    s.starts.push_back(count == 1 ? 0 : int(std::int64_t(frames - s.length) * i / (count - 1)));
  }
  return s;
}

PixelChoice::PixelChoice(int width, int height, int cell) : stride(cell) {
  const int columns = (width + cell - 1) / cell, rows = (height + cell - 1) / cell;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const std::uint64_t key = hash_key(std::uint64_t(i), std::uint64_t(j));
      const int x = i * cell + int(key % std::uint64_t(cell)), y = j * cell + int((key >> 32) % std::uint64_t(cell));
      pixels.push_back({std::min(x, width - 1), std::min(y, height - 1)});
    }
  }
  coverage = double(pixels.size()) / (double(width) * double(height));
}

Tracks::Tracks(const PixelChoice& choice) {
  positions_.reserve(choice.pixels.size());
  for (const PixelChoice::Pixel& p : choice.pixels) positions_.push_back({float(p.x) + 0.5f, float(p.y) + 0.5f});
}

void Tracks::advance(const Image& forward, const Image* backward) {
  if (forward.empty()) {
    constexpr float kNowhere = std::numeric_limits<float>::quiet_NaN();
    std::fill(positions_.begin(), positions_.end(), Vec2f{kNowhere, kNowhere});
    return;
  }
  for_each_block(int(positions_.size()), [&](int, int begin, int end) {
    for (int i = begin; i < end; ++i) {
      if (is_position(positions_[i])) positions_[i] = follow(positions_[i], forward, backward);
    }
  });
}

template <class Stored>
SegmentRecord<Stored>::SegmentRecord(const Segments& segments, std::shared_ptr<const PixelChoice> choice)
    : choice_(std::move(choice)), values_(int(choice_->pixels.size()), segments.length) {}

template <class Stored>
void SegmentRecord<Stored>::add(const Image& test, const Image& reference, const std::vector<Vec2f>* positions) {
  const auto& pixels = choice_->pixels;
  const std::span<Stored> out = values_.row(added_);
  const auto residual = [&](int x, int y) {
    return stored<Stored>(luminance(test.rgb(x, y)) - luminance(reference.rgb(x, y)));
  };
  for_each_block(values_.width(), [&](int, int begin, int end) {
    for (int i = begin; i < end; ++i) {
      if (positions) {
        const Vec2f p = (*positions)[i];
        out[i] = is_position(p) ? residual(int(p.x), int(p.y)) : stored<Stored>(kLost);
      } else {
        out[i] = residual(pixels[i].x, pixels[i].y);
      }
    }
  });
  ++added_;
}

template <class Stored>
void SegmentRecord<Stored>::add_to(PowerSums& sums) const {
  const int n = values_.height(), frequencies = n / 2 + 1;
  // w_t = sin^2(pi (t + 1/2) / n), the Hann window, times cosine and sine of each frequency, and normalized so that the
  // powers of a series e add up to the sum of (w e)^2 over that of w^2.
  Grid<float> cosine(n, frequencies), sine(n, frequencies);
  double weight = 0;
  for (int t = 0; t < n; ++t) weight += std::pow(std::sin(std::numbers::pi * (t + 0.5) / n), 4);
  for (int k = 0; k < frequencies; ++k) {
    const double both_signs = k == 0 || 2 * k == n ? 1 : 2;
    const double scale = std::sqrt(both_signs / (double(n) * weight));
    for (int t = 0; t < n; ++t) {
      const double window = std::pow(std::sin(std::numbers::pi * (t + 0.5) / n), 2);
      const double angle = 2 * std::numbers::pi * double(std::int64_t(k) * t % n) / n;
      cosine.at(t, k) = float(scale * window * std::cos(angle));
      sine.at(t, k) = float(scale * window * std::sin(angle));
    }
  }

  const int pixels = values_.width();
  struct Block {
    std::vector<double> power;
    int pixels = 0;
  };
  std::vector<Block> parts(blocks(pixels));
  for_each_block(pixels, [&](int block, int begin, int end) {
    thread_local Grid<float> series;
    series.assign(kBlock, n);
    // Pixels without a residual in some frame are all 0 and do not count.
    Block& part = parts[block];
    for (int i = begin; i < end; ++i) {
      bool finite = true;
      for (int t = 0; t < n; ++t) finite &= std::isfinite(restored(values_.at(i, t)));
      if (!finite) continue;
      ++part.pixels;
      for (int t = 0; t < n; ++t) series.at(i - begin, t) = restored(values_.at(i, t));
    }
    for (int k = 0; k < frequencies; ++k) {
      float re[kBlock] = {}, im[kBlock] = {};
      for (int t = 0; t < n; ++t) {
        const float c = cosine.at(t, k), s = sine.at(t, k);
        const float* const e = series.row(t).data();
        for (int i = 0; i < kBlock; ++i) re[i] += c * e[i], im[i] += s * e[i];
      }
      double power = 0;
      for (int i = 0; i < kBlock; ++i) power += double(re[i] * re[i] + im[i] * im[i]);
      part.power.push_back(power);
    }
  });
  sums.power.resize(frequencies);
  for (const Block& part : parts) {
    for (std::size_t k = 0; k < part.power.size(); ++k) sums.power[k] += part.power[k];
    sums.pixels += part.pixels;
  }
}

template class SegmentRecord<float>;
template class SegmentRecord<std::int16_t>;

ResidualSpectrum spectrum_of(std::string_view id, const Segments& segments, const PowerSums& sums, double coverage) {
  ResidualSpectrum s;
  s.id = id;
  s.segment_frames = segments.length;
  s.segments = int(segments.starts.size());
  s.coverage = coverage;
  for (std::size_t k = 0; k < sums.power.size(); ++k) {
    s.frequency.push_back(double(k) / segments.length);
    s.power.push_back(sums.pixels > 0 ? sums.power[k] / sums.pixels : kUndefined);
  }
  return s;
}

double power_above(const ResidualSpectrum& spectrum, double cutoff) {
  double sum = 0;
  for (std::size_t k = 0; k < spectrum.power.size(); ++k) {
    if (spectrum.frequency[k] > cutoff * (1 + 1e-9)) sum += spectrum.power[k];
  }
  return sum;
}

}  // namespace tempera
