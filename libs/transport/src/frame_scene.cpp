// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/frame_scene.h"

namespace tempera {

TimeSpan evaluation_span(const FrameClock& clock, int frame) {
  const TimeSpan exposure = clock.exposure(frame);
  return {exposure.begin - clock.frame_duration(), exposure.end + clock.frame_duration()};
}

namespace {

TimeSpan middle(const FrameClock& clock, int frame) {
  const TimeSpan exposure = clock.exposure(frame);
  const double t = 0.5 * (exposure.begin + exposure.end);
  return {t, t};
}

}  // namespace

FrameScene::FrameScene(const Scene& scene, const RenderSettings& settings, const LightPathClassifier& classifier,
                       int frame, double motion_step, GeometryCache& cache)
    : camera_(scene, settings.camera, settings.width, settings.height, evaluation_span(settings.clock, frame),
              motion_step),
      timeline_(
          scene, exposure_pieces(scene, settings.clock.exposure(frame), motion_step),
          [&](const TimeSpan&) { return evaluation_span(settings.clock, frame); }, motion_step, cache),
      cache_(cache),
      motion_step_(motion_step) {
  for (const SceneTimeline::Piece& piece : timeline_.pieces())
    contexts_.push_back({scene, piece.rays, piece.lights, camera_, classifier, settings, frame});
  context_.emplace(contexts_[0]);
  if (contexts_.size() > 1) context_->pieces = contexts_;
}

std::uint64_t FrameScene::memory() const { return timeline_.memory(); }

PrecedingFrame::PrecedingFrame(const FrameScene& now)
    : rays_(now.contexts_[0].scene, middle(now.contexts_[0].settings.clock, now.contexts_[0].frame - 1),
            evaluation_span(now.contexts_[0].settings.clock, now.contexts_[0].frame - 1),
            {.motion_step = now.motion_step_}, now.cache_),
      context_{now.contexts_[0].scene,      rays_,
               now.contexts_[0].lights,     now.camera_,
               now.contexts_[0].classifier, now.contexts_[0].settings,
               now.contexts_[0].frame - 1} {}

}  // namespace tempera
