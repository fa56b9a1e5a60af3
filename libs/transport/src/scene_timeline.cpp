// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/scene_timeline.h"

#include <algorithm>

#include "tempera/accel/motion_grid.h"

namespace tempera {

std::vector<TimeSpan> timeline_pieces(const Scene& scene, TimeSpan span, double motion_step) {
  constexpr int kChunk = 64, kLargest = 126;  // segments; knots stand up to one beyond either end of a piece
  std::vector<TimeSpan> pieces;
  const auto jumps_at_end = [&](const TimeSpan& a, const TimeSpan& b) {
    return !exposure_jumps(scene, {0.5 * (a.begin + a.end), 0.5 * (b.begin + b.end)}).empty();
  };
  double begin = span.begin;
  do {
    double end = std::min(begin + kChunk * motion_step, span.end);
    if (span.end - end < motion_step) end = span.end;  // no sliver is left
    for (const TimeSpan& piece : exposure_pieces(scene, {begin, end}, motion_step)) {
      const bool fits = !pieces.empty() && piece.end - pieces.back().begin <= kLargest * motion_step;
      if (fits && !jumps_at_end(pieces.back(), piece)) {
        pieces.back().end = piece.end;
      } else {
        pieces.push_back(piece);
      }
    }
    begin = end;
  } while (begin < span.end);
  return pieces;
}

SceneTimeline::SceneTimeline(const Scene& scene, const std::vector<TimeSpan>& pieces,
                             const std::function<TimeSpan(const TimeSpan& piece)>& evaluation, double motion_step,
                             GeometryCache& cache) {
  TEMPERA_ASSERT(!pieces.empty());
  for (const TimeSpan& piece : pieces) pieces_.emplace_back(scene, piece, evaluation(piece), motion_step, cache);
}

const SceneTimeline::Piece& SceneTimeline::at(double t) const {
  TEMPERA_ASSERT(t >= span().begin && t <= span().end);
  const auto after = std::upper_bound(pieces_.begin(), pieces_.end(), t,
                                      [](double time, const Piece& p) { return time < p.rays.rays().begin; });
  return after == pieces_.begin() ? pieces_.front() : *std::prev(after);
}

std::uint64_t SceneTimeline::memory() const {
  std::uint64_t largest = 0;  // each counts the cache, and they are alike
  for (const Piece& p : pieces_) largest = std::max(largest, p.rays.memory());
  return largest;
}

}  // namespace tempera
