// SPDX-License-Identifier: Apache-2.0
#pragma once
// How the context of a frame is made of a scene: the one place where it is.
#include <optional>
#include <vector>

#include "tempera/transport/frame_context.h"
#include "tempera/transport/scene_timeline.h"

namespace tempera {

/// Times at which points of a frame can be evaluated (seconds): its exposure, and a frame more on both sides.
TimeSpan evaluation_span(const FrameClock& clock, int frame);

/// What the rays of a frame meet, as far as the scene says: the exposure in pieces between jumps, each with the matter
/// and the lights that are visible in it, and the camera. Points can be evaluated a frame further on both sides, where
/// motion vectors look.
class FrameScene {
 public:
  /// `motion_step`: seconds between the knots of the motion grid. Everything that is given must outlive this.
  /// Errors: those of RayScene and CameraModel.
  FrameScene(const Scene& scene, const RenderSettings& settings, const LightPathClassifier& classifier, int frame,
             double motion_step, GeometryCache& cache);
  FrameScene(const FrameScene&) = delete;
  FrameScene& operator=(const FrameScene&) = delete;

  const FrameContext& context() const { return *context_; }
  /// Bytes held by Embree and by vertex buffers, the cache's included.
  std::uint64_t memory() const;
  std::size_t piece_count() const { return timeline_.pieces().size(); }

 private:
  friend class PrecedingFrame;
  CameraModel camera_;
  SceneTimeline timeline_;               // of the exposure
  std::vector<FrameContext> contexts_;   // of the pieces
  std::optional<FrameContext> context_;  // of the whole exposure
  GeometryCache& cache_;
  double motion_step_;
};

/// The frame before another, as temporal differences look at it: its rays serve the middle of its exposure only.
class PrecedingFrame {
 public:
  /// `now` must outlive this.
  explicit PrecedingFrame(const FrameScene& now);
  const FrameContext& context() const { return context_; }

 private:
  RayScene rays_;
  FrameContext context_;
};

}  // namespace tempera
