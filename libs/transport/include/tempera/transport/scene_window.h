// SPDX-License-Identifier: Apache-2.0
#pragma once
// What a method sees of the shot while it renders a section: the frames' scenes, built when they are first asked for.
#include <map>
#include <memory>
#include <mutex>

#include "tempera/transport/frame_scene.h"

namespace tempera {

/// Frames that may be looked at before the first and after the last of a section.
struct FrameReach {
  int before = 0, after = 0;
};

/// Threads: safe from many.
class SceneWindow {
 public:
  /// `motion_step`: seconds between the knots of the motion grid. Everything that is given must outlive this.
  SceneWindow(const Scene& scene, const RenderSettings& settings, const LightPathClassifier& classifier,
              double motion_step, GeometryCache& cache, FrameRange section);

  const Scene& scene() const { return scene_; }
  const RenderSettings& settings() const { return settings_; }
  FrameRange section() const { return section_; }
  /// How far its users say that they look. Asking for more is an assertion failure.
  void set_reach(FrameReach reach) { reach_ = reach; }

  /// A frame of the section or within reach. Errors: those of RayScene and CameraModel.
  const FrameContext& frame(int frame) const;
  /// The frame before `frame`, whose rays serve the middle of its exposure only: cheaper, and enough to see what moved.
  const FrameContext& middle_of_frame_before(int frame) const;
  /// What is there at any time from the first frame's exposure to the end of the last one's, gaps between shutters
  /// included; points of a piece can be evaluated a frame before and after it. Built when it is first asked for: ask
  /// once, as `frame` does it takes a lock. Errors: those of RayScene.
  const SceneTimeline& timeline() const;
  /// What is there from the middle of the exposure of the frame before `frame` to that of the frame after it, in all scan
  /// lines; no further than to cuts. Built when it is first asked for, which begin_pass does. Errors: those of RayScene.
  const SceneTimeline& neighbourhood(int frame) const;
  /// Bytes held by Embree and by vertex buffers, and pieces between jumps of the frames that were asked for.
  std::uint64_t memory() const;
  std::size_t piece_count() const;

 private:
  FrameScene& build(int frame) const;
  std::unique_ptr<SceneTimeline> build_timeline(TimeSpan span) const;

  const Scene& scene_;
  const RenderSettings& settings_;
  const LightPathClassifier& classifier_;
  double motion_step_;
  GeometryCache& cache_;
  FrameRange section_;
  FrameReach reach_;
  mutable std::mutex mutex_;
  mutable std::map<int, std::unique_ptr<FrameScene>> frames_;
  mutable std::map<int, std::unique_ptr<PrecedingFrame>> preceding_;
  mutable std::map<int, std::unique_ptr<SceneTimeline>> neighbourhoods_;
  mutable std::unique_ptr<SceneTimeline> timeline_;
};

}  // namespace tempera
