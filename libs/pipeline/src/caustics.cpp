// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/caustics.h"

#include <algorithm>
#include <vector>

#include "tempera/core/parallel.h"
#include "tempera/methods/method.h"
#include "tempera/photons/photon_map.h"
#include "tempera/transport/frame_scene.h"

namespace tempera {

namespace {

constexpr int kLongSide = 64;        ///< pixels
constexpr int kSamples = 4;          ///< of a pixel
constexpr int kPhotons = 20000;      ///< of a frame
constexpr float kNoticeable = 0.2f;  ///< part of a pixel's light

/// Traces photons of an exposure, `count` in all, and makes maps of them if they are asked for.
PhotonCounts trace_photons(const FrameContext& frame, const PhotonOptions& options, std::int64_t count, int max_depth,
                           PhotonLight* light) {
  constexpr std::int64_t kTogether = 4096;
  PhotonCounts counts;
  const TimeSpan exposure = frame.settings.clock.exposure(frame.frame);
  const std::vector<ExposurePiece> pieces = exposure_pieces_of(frame);
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    const FrameContext& piece = *pieces[i].context;
    const auto sets = int(options.instants_of(pieces[i].span).size());
    for (int set = 0; set < sets; ++set) {
      const PhotonTracer tracer(piece, options, pieces[i].span, set, count / sets, max_depth);
      const std::int64_t parts = (tracer.photons() + kTogether - 1) / kTogether;
      std::vector<std::vector<Photon>> photons(parts);
      std::vector<PhotonCounts> part_counts(parts);
      parallel_for(0, parts, [&](std::int64_t part) {
        std::uint64_t rays = 0;
        const std::int64_t end = std::min(tracer.photons(), (part + 1) * kTogether);
        for (std::int64_t k = part * kTogether; k < end; ++k) tracer.trace(k, photons[part], part_counts[part], rays);
        if (!light) photons[part].clear();
      });
      std::vector<Photon> all;
      for (std::int64_t part = 0; part < parts; ++part) {
        counts += part_counts[part];
        all.insert(all.end(), photons[part].begin(), photons[part].end());
      }
      if (!light) continue;
      light->add(i, PhotonMap(tracer, std::move(all), piece.classifier, piece.rays, needs_instants(frame, exposure)));
    }
  }
  return counts;
}

double coverage(const FrameContext& frame, const PhotonOptions& options, const PathOptions& paths) {
  PhotonLight light(frame, 1);
  if (trace_photons(frame, options, kPhotons, paths.max_depth, &light).stored == 0) return 0;
  const int w = frame.settings.width, h = frame.settings.height;
  std::vector<int> lit(h);
  parallel_for(0, h, [&](std::int64_t row) {
    const int y = int(row);
    for (int x = 0; x < w; ++x) {
      float all = 0, caustics = 0;
      for (int i = 0; i < kSamples; ++i) {
        const CameraSample camera = camera_sample(frame, x, y, i);
        NoObserver none;
        const SampleResult r =
            trace_path(frame.at(camera.time), paths, camera, {}, Features::kNone, none, nullptr, &light);
        all += luminance(r.radiance), caustics += luminance(r.gathered);
      }
      lit[y] += caustics > kNoticeable * all;
    }
  });
  int sum = 0;
  for (const int n : lit) sum += n;
  return double(sum) / (double(w) * double(h));
}

}  // namespace

double caustics_coverage(const Scene& scene, const Shot& shot) {
  RenderSettings s = shot.settings;
  const double scale = std::min(1.0, double(kLongSide) / std::max(s.width, s.height));
  s.width = std::max(1, int(s.width * scale)), s.height = std::max(1, int(s.height * scale));
  s.crop_width = 0;
  s.spp = kSamples;
  s.layers = {"color"};
  s.classes.clear();
  const LightPathClassifier classifier({kPhotonPaths});
  GeometryCache cache;
  const int first = shot.sequence.first, last = shot.sequence.last;
  double most = 0;
  for (const int frame : {first, first + (last - first) / 2, last}) {
    const FrameScene made(scene, s, classifier, frame, s.clock.frame_duration() / shot.motion_segments, cache);
    if (!find_casters(made.context().rays, s.clock.exposure(frame)).empty())
      most = std::max(most, coverage(made.context(), PhotonOptions(shot.params), PathOptions(shot.params)));
    if (first == last) break;
  }
  return most;
}

std::optional<PhotonSurvey> survey_photons(const Scene& scene, const Shot& shot) {
  const std::vector<std::string> own = find_method(shot.integrator).make(shot.params)->own_classes();
  if (std::find(own.begin(), own.end(), kPhotonPaths) == own.end() || shot.frames.empty()) return std::nullopt;
  const RenderSettings& s = shot.settings;
  const LightPathClassifier classifier({kPhotonPaths});
  GeometryCache cache;
  const int frame = shot.frames.front();
  const FrameScene made(scene, s, classifier, frame, s.clock.frame_duration() / shot.motion_segments, cache);
  const PhotonOptions options(shot.params);
  PhotonSurvey survey;
  survey.casters = int(find_casters(made.context().rays, s.clock.exposure(frame)).size());
  survey.counts =
      trace_photons(made.context(), options, options.photons_for(s), PathOptions(shot.params).max_depth, nullptr);
  return survey;
}

}  // namespace tempera
