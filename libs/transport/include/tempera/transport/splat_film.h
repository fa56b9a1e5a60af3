// SPDX-License-Identifier: Apache-2.0
#pragma once
// Pictures that any unit of work may add to anywhere: sums in 64-bit fixed point. Adding whole numbers is the same in
// any order, so the bits do not depend on threads, and parts from several machines add up to those of one run.
#include <cstdint>
#include <span>
#include <vector>

#include "tempera/core/bytes.h"
#include "tempera/core/vec.h"
#include "tempera/frames/image.h"

namespace tempera {

/// RGB sums of the pixels of several frames. Threads: `add` from many; the rest from one.
class SplatFilm {
 public:
  SplatFilm() = default;
  /// `range` > 0: sums are exact to range / 2^62; at least as large as any of them gets. One that leaves it is a lost
  /// value, and is counted. (Which of several values a pixel at its limit loses depends on their order.)
  SplatFilm(int frames, int width, int height, double range);

  int frames() const { return frames_; }
  int width() const { return width_; }
  int height() const { return height_; }

  /// Adds to a pixel. Values must be finite. Pre: frame and pixel exist.
  void add(int frame, int x, int y, const Rgb& value);
  /// Adds all sums of a film of the same shape and range. Errors: Error{kBadInput} for another one.
  void merge(const SplatFilm& other);
  /// The sums of a frame times `scale`: [h,w,3].
  Image image(int frame, double scale) const;
  /// Values that were too large for the range.
  std::uint64_t lost() const { return lost_; }

  void save(ByteWriter& out) const;
  /// Errors: Error{kBadInput} for a film of another shape or range.
  void load(ByteReader& in);

 private:
  std::size_t offset(int frame, int x, int y) const;
  void add(std::size_t i, std::int64_t units);

  int frames_ = 0, width_ = 0, height_ = 0;
  double range_ = 1;
  std::vector<std::int64_t> sums_;
  std::uint64_t lost_ = 0;
};

}  // namespace tempera
