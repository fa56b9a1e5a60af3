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

std::unique_ptr<SceneTimeline> SceneWindow::build_timeline(TimeSpan span) const {
  const double frame = settings_.clock.frame_duration();
  const auto evaluation = [&](const TimeSpan& piece) { return TimeSpan{piece.begin - frame, piece.end + frame}; };
  return std::make_unique<SceneTimeline>(scene_, timeline_pieces(scene_, span, motion_step_), evaluation, motion_step_,
                                         cache_);
}

const SceneTimeline& SceneWindow::timeline() const {
  const std::scoped_lock lock(mutex_);
  if (!timeline_) {
    const FrameClock& clock = settings_.clock;
    timeline_ = build_timeline({clock.exposure(section_.first).begin, clock.exposure(section_.last).end});
  }
  return *timeline_;
}

const SceneTimeline& SceneWindow::neighbourhood(int frame) const {
  TEMPERA_ASSERT(section_.contains(frame));
  const std::scoped_lock lock(mutex_);
  std::unique_ptr<SceneTimeline>& built = neighbourhoods_[frame];
  if (!built) {
    const FrameClock& clock = settings_.clock;
    const int first = settings_.is_cut(frame) ? frame : frame - 1;
    const int last = settings_.is_cut(frame + 1) ? frame : frame + 1;
    const double step = clock.frame_duration();
    const double a = clock.exposure_time(frame, 0.5, 0), b = clock.exposure_time(frame, 0.5, 1);
    const TimeSpan span{std::min(a, b) + (first - frame) * step, std::max(a, b) + (last - frame) * step};
    built = std::make_unique<SceneTimeline>(
        scene_, timeline_pieces(scene_, span, motion_step_), [](const TimeSpan& piece) { return piece; }, motion_step_,
        cache_);
  }
  return *built;
}

std::uint64_t SceneWindow::memory() const {
  const std::scoped_lock lock(mutex_);
  std::uint64_t largest = 0;  // each counts the cache, and they are alike
  for (const auto& [number, frame] : frames_) largest = std::max(largest, frame->memory());
  for (const auto& [number, timeline] : neighbourhoods_) largest = std::max(largest, timeline->memory());
  return largest;
}

std::size_t SceneWindow::piece_count() const {
  const std::scoped_lock lock(mutex_);
  std::size_t count = 0;
  for (const auto& [number, frame] : frames_) count += frame->piece_count();
  return count;
}

}  // namespace tempera
