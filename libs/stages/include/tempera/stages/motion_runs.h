// SPDX-License-Identifier: Apache-2.0
#pragma once
// Correspondence of pixels between two frames, compiled into stretches of scan lines that move by one displacement, so
// that loops over corresponding pixels are loops over contiguous memory. Not motion vectors, which are real numbers and
// not one-to-one: see `motion.forward`.
#include <cstdint>
#include <span>
#include <vector>

#include "tempera/core/grid.h"
#include "tempera/core/vec.h"

namespace tempera {

/// Pixels (x .. x + length - 1, y) of a frame, which correspond to (x + dx .. , y + dy) of the next one.
/// The rows of differences between the frames that exist for them: a temporal one for each pixel; a mixed one with the
/// right neighbour for the first `mixed_x` pixels; a mixed one with the neighbour below for all or none.
struct MotionRun {
  int y = 0, x = 0, length = 0;
  int dx = 0, dy = 0;
  int mixed_x = 0;  ///< length, length - 1, or 0
  bool mixed_y = false;
  bool operator==(const MotionRun&) const = default;
};

/// Partial one-to-one map phi from the pixels of a frame to those of the next one, and which mixed differences exist.
class PixelMap {
 public:
  /// Nothing corresponds.
  PixelMap(int width, int height);

  int width() const { return forward_.width(); }
  int height() const { return forward_.height(); }
  /// Sets phi(from) = to. Returns false, and changes nothing, if one of them lies outside or has a partner already.
  bool link(int from_x, int from_y, int to_x, int to_y);
  /// phi at (x, y); x is -1 where nothing corresponds.
  Vec2<int> forward(int x, int y) const { return decode(forward_.at(x, y)); }
  /// The inverse of phi.
  Vec2<int> backward(int x, int y) const { return decode(backward_.at(x, y)); }
  /// Pixels that have a partner.
  std::int64_t count() const { return count_; }

 private:
  Vec2<int> decode(std::int32_t i) const { return i < 0 ? Vec2<int>{-1, -1} : Vec2<int>{i % width(), i / width()}; }
  std::int64_t count_ = 0;
  Grid<std::int32_t> forward_, backward_;  // index of the partner; -1: none
};

struct MotionRunOptions {
  bool mixed = true;          ///< whether mixed differences exist at all
  bool strict_mixed = false;  ///< only where the neighbour moves along: phi(i + e) = phi(i) + e
};

/// The runs of a PixelMap.
class MotionRuns {
 public:
  MotionRuns() = default;
  /// `sampled_next.at(x, y)` != 0: the pixel of the next frame has samples of the offset pass, so differences
  /// with it as the neighbour exist; empty: all have. Runs are at most kMaxLength long.
  MotionRuns(const PixelMap& motion, const MotionRunOptions& options = {}, const Grid<std::uint8_t>& sampled_next = {});

  static constexpr int kMaxLength = 512;
  /// Runs that start in row `y` of the frame, from left to right.
  std::span<const MotionRun> from_row(int y) const { return row(from_, from_begin_, y); }
  /// Runs that end in row `y` of the next frame, from left to right there.
  std::span<const MotionRun> to_row(int y) const { return row(to_, to_begin_, y); }
  std::size_t size() const { return from_.size(); }
  /// Pixels that have a partner.
  std::int64_t count() const { return count_; }
  /// Whether every pixel corresponds to itself.
  bool is_identity() const { return identity_; }
  /// Whether all mixed differences exist whose neighbours are inside of the picture.
  bool has_all_mixed() const { return all_mixed_; }

 private:
  static std::span<const MotionRun> row(const std::vector<MotionRun>& runs, const std::vector<std::uint32_t>& begin,
                                        int y) {
    return {runs.data() + begin[y], runs.data() + begin[y + 1]};
  }
  std::vector<MotionRun> from_, to_;
  std::vector<std::uint32_t> from_begin_, to_begin_;
  std::int64_t count_ = 0;
  bool identity_ = false, all_mixed_ = false;
};

}  // namespace tempera
