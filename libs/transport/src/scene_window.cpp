// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/scene_window.h"

#include <algorithm>

namespace tempera {

SceneWindow::SceneWindow(const Scene& scene, const RenderSettings& settings, const LightPathClassifier& classifier,
                         double motion_step, GeometryCache& cache, FrameRange section)
    : scene_(scene),
      settings_(settings),
      classifier_(classifier),
      motion_step_(motion_step),
      cache_(cache),
      section_(section) {}

FrameScene& SceneWindow::build(int frame) const {
  TEMPERA_ASSERT(frame >= section_.first - reach_.before && frame <= section_.last + reach_.after);
  std::unique_ptr<FrameScene>& built = frames_[frame];
  if (!built) built = std::make_unique<FrameScene>(scene_, settings_, classifier_, frame, motion_step_, cache_);
  return *built;
}

const FrameContext& SceneWindow::frame(int frame) const {
  const std::scoped_lock lock(mutex_);
  return build(frame).context();
}

const FrameContext& SceneWindow::middle_of_frame_before(int frame) const {
  TEMPERA_ASSERT(frame - 1 >= section_.first - reach_.before);
  const std::scoped_lock lock(mutex_);
  std::unique_ptr<PrecedingFrame>& built = preceding_[frame];
  if (!built) built = std::make_unique<PrecedingFrame>(build(frame));
  return built->context();
}

const SceneTimeline& SceneWindow::timeline() const {
  const std::scoped_lock lock(mutex_);
  if (!timeline_) {
    const FrameClock& clock = settings_.clock;
    const double frame = clock.frame_duration();
    const TimeSpan span{clock.exposure(section_.first).begin, clock.exposure(section_.last).end};
    timeline_ = std::make_unique<SceneTimeline>(
        scene_, timeline_pieces(scene_, span, motion_step_),
        [&](const TimeSpan& piece) {
          return TimeSpan{piece.begin - frame, piece.end + frame};
        },
        motion_step_, cache_);
  }
  return *timeline_;
}

std::uint64_t SceneWindow::memory() const {
  const std::scoped_lock lock(mutex_);
  std::uint64_t largest = 0;  // each counts the cache, and they are alike
  for (const auto& [number, frame] : frames_) largest = std::max(largest, frame->memory());
  return largest;
}

std::size_t SceneWindow::piece_count() const {
  const std::scoped_lock lock(mutex_);
  std::size_t count = 0;
  for (const auto& [number, frame] : frames_) count += frame->piece_count();
  return count;
}

}  // namespace tempera
