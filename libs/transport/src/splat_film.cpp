// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/splat_film.h"

#include <atomic>
#include <cmath>

namespace tempera {

namespace {

constexpr std::int64_t kLimit = std::int64_t(1) << 62;  // of sums: what stands for the range

}  // namespace

SplatFilm::SplatFilm(int frames, int width, int height, double range)
    : frames_(frames),
      width_(width),
      height_(height),
      range_(range),
      sums_(std::size_t(frames) * std::size_t(width) * std::size_t(height) * 3) {
  TEMPERA_ASSERT(range > 0);
}

std::size_t SplatFilm::offset(int frame, int x, int y) const {
  TEMPERA_ASSERT(frame >= 0 && x >= 0 && y >= 0 && frame < frames_ && x < width_ && y < height_);
  return ((std::size_t(frame) * std::size_t(height_) + std::size_t(y)) * std::size_t(width_) + std::size_t(x)) * 3;
}

void SplatFilm::add(std::size_t i, std::int64_t units) {
  std::atomic_ref<std::int64_t> sum(sums_[i]);
  const std::int64_t before = sum.fetch_add(units, std::memory_order_relaxed);
  // Both are within the limit, so the sum is a number; beyond the limit it is pushed back.
  if (before + units > kLimit || before + units < -kLimit) {
    sum.fetch_sub(units, std::memory_order_relaxed);
    std::atomic_ref(lost_).fetch_add(1, std::memory_order_relaxed);
  }
}

void SplatFilm::add(int frame, int x, int y, const Rgb& value) {
  const std::size_t at = offset(frame, x, y);
  const double scale = double(kLimit) / range_;
  for (int c = 0; c < 3; ++c) {
    const double units = double(value[c]) * scale;
    if (std::abs(units) >= double(kLimit)) {
      std::atomic_ref(lost_).fetch_add(1, std::memory_order_relaxed);
    } else if (units != 0) {
      add(at + std::size_t(c), std::int64_t(std::llrint(units)));
    }
  }
}

void SplatFilm::merge(const SplatFilm& other) {
  if (other.frames_ != frames_ || other.width_ != width_ || other.height_ != height_ || other.range_ != range_)
    throw Error(ErrorCode::kBadInput, "its sums are of another size or range");
  for (std::size_t i = 0; i < sums_.size(); ++i) add(i, other.sums_[i]);
  lost_ += other.lost_;
}

Image SplatFilm::image(int frame, double scale) const {
  Image result(width_, height_, 3);
  const double unit = range_ / double(kLimit) * scale;
  const std::size_t first = offset(frame, 0, 0);
  const std::span<float> values = result.values();
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = float(double(sums_[first + i]) * unit);
  return result;
}

void SplatFilm::save(ByteWriter& out) const {
  out.value(frames_);
  out.value(width_);
  out.value(height_);
  out.value(range_);
  out.value(lost_);
  out.values(sums_);
}

void SplatFilm::load(ByteReader& in) {
  const auto frames = in.value<int>(), width = in.value<int>(), height = in.value<int>();
  const auto range = in.value<double>();
  const auto lost = in.value<std::uint64_t>();
  std::vector<std::int64_t> sums;
  in.values(sums);
  if (frames != frames_ || width != width_ || height != height_ || range != range_ || sums.size() != sums_.size())
    throw Error(ErrorCode::kBadInput, "its sums are of another size or range");
  sums_ = std::move(sums);
  lost_ = lost;
}

}  // namespace tempera
