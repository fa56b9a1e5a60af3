// SPDX-License-Identifier: Apache-2.0
#pragma once
// The grid of knots on the shot's axis between which all motion is interpolated, and its pieces between jumps.
//
// Motion is resampled at knots k * step. Where something jumps, two pieces meet: each has knots of its own, and those
// beyond the jump say how the motion of that piece would have gone on, so that nothing lies between the two poses.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "tempera/core/time.h"
#include "tempera/scene/scene.h"

namespace tempera {

/// Knot k stands at k * step seconds.
struct MotionGrid {
  double step = 1;
  struct Position {
    std::int64_t knot = 0;  ///< the knot at or before the time
    double blend = 0;       ///< in [0,1]: towards the next knot
  };
  Position locate(double t) const {
    const double x = t / step, k = std::floor(x + 1e-9);  // a time that is meant to be a knot is that knot
    return {std::int64_t(k), std::clamp(x - k, 0.0, 1.0)};
  }
  double time(std::int64_t knot) const { return double(knot) * step; }
  std::int64_t first(TimeSpan span) const { return std::int64_t(std::floor(span.begin / step + 1e-9)); }
  std::int64_t last(TimeSpan span) const { return std::int64_t(std::ceil(span.end / step - 1e-9)); }
};

/// A span of time cut at jumps, and the knots of its pieces, all in one row.
class MotionPieces {
 public:
  MotionPieces() = default;
  /// `jumps`: times in any order, within `span` or not. Times in `whole` belong to one piece, which holds its middle.
  MotionPieces(MotionGrid grid, TimeSpan span, std::vector<double> jumps, TimeSpan whole);

  struct Knot {
    double time = 0;   ///< seconds
    double piece = 0;  ///< a time of the piece that it belongs to; see Animated::at
  };
  /// In time order within each piece.
  const std::vector<Knot>& knots() const { return knots_; }
  /// Between which two knots a time lies, clamped to those that there are. Threads: re-entrant.
  struct Position {
    std::size_t knot = 0;  ///< the first of the two; blend is 0 where there is no second
    double blend = 0;
  };
  Position locate(double t) const {
    const Piece& p = piece_of(t);
    auto [knot, blend] = grid_.locate(t);
    if (knot < p.first) knot = p.first, blend = 0;
    if (knot >= p.last) knot = p.last, blend = 0;
    return {p.index(knot), blend};
  }
  /// The segment that a time lies in: the later one at a knot, the last one at the end of a piece, and both knots the
  /// same where a piece has one alone.
  struct Segment {
    std::size_t knot = 0, next = 0;
    double blend = 0;
  };
  Segment segment(double t) const {
    const Piece& p = piece_of(t);
    auto [knot, blend] = grid_.locate(t);
    if (knot < p.first) knot = p.first, blend = 0;
    if (knot >= p.last) knot = std::max(p.last - 1, p.first), blend = 1;
    const std::size_t at = p.index(knot);
    return {at, p.first < p.last ? at + 1 : at, blend};
  }
  /// The knots that motion within `span` is interpolated between, piece by piece: from the knot at or before the
  /// begin of what the span and a piece share to the one at or after its end.
  struct Stretch {
    std::size_t first = 0, last = 0;
    TimeSpan span;
  };
  std::vector<Stretch> stretches(TimeSpan span) const;
  /// Index of the knot at grid position `knot` of the piece that `whole` lies in.
  std::size_t index(std::int64_t knot) const { return pieces_[whole_].index(knot); }
  const MotionGrid& grid() const { return grid_; }

 private:
  struct Piece {
    double begin = 0;
    std::int64_t first = 0, last = 0;  // grid positions of its knots
    std::size_t offset = 0;            // of its first knot in knots_
    std::size_t index(std::int64_t knot) const { return offset + (knot - first); }
  };
  const Piece& piece_of(double t) const {
    if (pieces_.size() == 1 || (t >= whole_span_.begin && t <= whole_span_.end)) return pieces_[whole_];
    std::size_t i = 0;
    while (i + 1 < pieces_.size() && t >= pieces_[i + 1].begin) ++i;
    return pieces_[i];
  }

  MotionGrid grid_;
  TimeSpan whole_span_;
  std::size_t whole_ = 0;
  std::vector<Piece> pieces_;
  std::vector<Knot> knots_;
};

/// Times within an exposure at which matter jumps or appears or disappears, in order; those that leave no more than
/// rounding on one side are left out. At most 64 are told apart: of more, every n-th is taken, with a warning.
std::vector<double> exposure_jumps(const Scene& scene, TimeSpan exposure);

/// An exposure cut where something jumps, and so that no piece has more than 128 segments between knots `motion_step`
/// seconds apart: what one RayScene can hold. At least one piece, in order, without gaps.
std::vector<TimeSpan> exposure_pieces(const Scene& scene, TimeSpan exposure, double motion_step);

}  // namespace tempera
