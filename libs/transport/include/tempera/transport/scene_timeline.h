// SPDX-License-Identifier: Apache-2.0
#pragma once
// What rays meet over a span of time, however long: pieces, each with the matter and the lights that are visible in it.
#include <deque>
#include <functional>
#include <vector>

#include "tempera/accel/ray_scene.h"
#include "tempera/paths/light_sampler.h"

namespace tempera {

/// A span cut where something jumps, appears or disappears, and so that no piece has more than 128 segments between knots
/// `motion_step` seconds apart; pieces are no shorter than that asks for. In order, without gaps; at least one.
/// Pre: motion_step > 0.
std::vector<TimeSpan> timeline_pieces(const Scene& scene, TimeSpan span, double motion_step);

/// Threads: const use is re-entrant, and takes no lock.
class SceneTimeline {
 public:
  struct Piece {
    Piece(const Scene& scene, TimeSpan span, TimeSpan evaluation, double motion_step, GeometryCache& cache)
        : rays(scene, span, evaluation, {.motion_step = motion_step}, cache), lights(scene, rays) {}
    RayScene rays;
    LightSampler lights;
  };
  /// `pieces`: spans in order without gaps, as timeline_pieces has them; `evaluation`: over what span points of a piece can
  /// be evaluated, beyond its rays. Errors: those of RayScene. What is given by reference must outlive this.
  SceneTimeline(const Scene& scene, const std::vector<TimeSpan>& pieces,
                const std::function<TimeSpan(const TimeSpan& piece)>& evaluation, double motion_step,
                GeometryCache& cache);
  SceneTimeline(const SceneTimeline&) = delete;
  SceneTimeline& operator=(const SceneTimeline&) = delete;

  /// The piece of time t (s). A time at which something jumps belongs to the piece that begins there. Pre: within the span.
  const Piece& at(double t) const;
  const std::deque<Piece>& pieces() const { return pieces_; }
  TimeSpan span() const { return {pieces_.front().rays.rays().begin, pieces_.back().rays.rays().end}; }
  /// Bytes held by Embree and by vertex buffers, the cache's included.
  std::uint64_t memory() const;

 private:
  std::deque<Piece> pieces_;  // they stay where they are
};

}  // namespace tempera
