// SPDX-License-Identifier: Apache-2.0
#pragma once
// What is fixed while one frame renders, and how its work is divided, addressed and counted.
#include <atomic>
#include <cstdint>
#include <mutex>
#include <span>
#include <vector>

#include "tempera/accel/ray_scene.h"
#include "tempera/paths/camera_model.h"
#include "tempera/paths/light_path_expression.h"
#include "tempera/paths/light_sampler.h"
#include "tempera/scene/scene.h"
#include "tempera/transport/settings.h"

namespace tempera {

/// Everything that is fixed while one frame renders (frame_scene.h makes it).
struct FrameContext {
  const Scene& scene;
  const RayScene& rays;        ///< of the first piece of the exposure between jumps
  const LightSampler& lights;  ///< likewise
  const CameraModel& camera;
  const LightPathClassifier& classifier;
  const RenderSettings& settings;
  int frame = 0;
  /// For each piece of the exposure what its rays and lights are; none if there is but one piece.
  std::span<const FrameContext> pieces{};

  /// Which piece time t (seconds) lies in; 0 if there are none.
  std::size_t piece_at(double t) const {
    std::size_t i = 0;
    while (i + 1 < pieces.size() && t >= pieces[i + 1].rays.rays().begin) ++i;
    return i;
  }
  /// This context for paths of time t (seconds): their rays meet what is there then.
  const FrameContext& at(double t) const { return pieces.empty() ? *this : pieces[piece_at(t)]; }
};

/// Pixels [x0,x1) x [y0,y1) of a frame.
struct Tile {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
};

/// Which random numbers a pixel takes: those of a pixel of a stream, usually its own of its frame.
struct PixelKey {
  static constexpr int kFullRotation = 256;
  std::int64_t stream = 0;
  int x = 0, y = 0;
  /// Added to the two numbers that place a sample on the film, modulo 1; in units of 1 / kFullRotation.
  int rotation_x = 0, rotation_y = 0;
  bool operator==(const PixelKey&) const = default;
};
/// The numbers that pixel (x, y) of a frame has for itself.
inline PixelKey own_key(const RenderSettings& settings, int frame, int x, int y) {
  return {settings.seed_per_frame ? frame : 0, x, y};
}

/// A sample of pixel (x, y) that was not finite. It was dropped (the pixel averages over the others).
struct BadSample {
  int frame = 0, x = 0, y = 0, sample = 0;
  PixelKey numbers;  ///< that it took
};

/// Counts over a render. Threads: updated once per tile.
struct RenderCounters {
  std::atomic<std::uint64_t> samples{0}, rays{0}, shadow_rays{0}, bad_samples{0};
  void note_bad(const BadSample& s) {
    ++bad_samples;
    const std::scoped_lock lock(mutex);
    if (first_bad.size() < 16) first_bad.push_back(s);
  }
  std::mutex mutex;
  std::vector<BadSample> first_bad;
};

}  // namespace tempera
