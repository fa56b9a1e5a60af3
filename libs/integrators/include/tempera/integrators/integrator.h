// SPDX-License-Identifier: Apache-2.0
#pragma once
// An integrator estimates light transport and writes named layers. It owns no threads and no files: the pipeline cuts a
// shot into work units (tiles of a frame), runs them in any order and writes the frames.
#include <algorithm>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "tempera/accel/ray_scene.h"
#include "tempera/core/params.h"
#include "tempera/core/time.h"
#include "tempera/frames/frame.h"
#include "tempera/frames/layers.h"
#include "tempera/paths/camera_model.h"
#include "tempera/paths/light_path_expression.h"
#include "tempera/paths/light_sampler.h"
#include "tempera/paths/pixel_filter.h"
#include "tempera/paths/sample_stream.h"
#include "tempera/scene/scene.h"

namespace tempera {

/// A class of light paths that is wanted as layers of its own.
struct PathClass {
  std::string name;        ///< layer class.<name>.color
  std::string expression;  ///< e.g. "ERD.*"; see light_path_expression.h
};

/// A setting that an integrator cannot do with. Loaders turn it into an error at the place of the setting.
class SettingError : public Error {
 public:
  /// `key`: of the setting in shot.toml, e.g. "sampling.spp".
  SettingError(ErrorCode code, std::string key, std::string message)
      : Error(code, std::move(message)), key_(std::move(key)) {}
  const std::string& key() const { return key_; }

 private:
  std::string key_;
};

/// What is rendered, apart from the scene and the integrator's own parameters.
struct RenderSettings {
  int width = 1280, height = 720;
  int crop_x = 0, crop_y = 0, crop_width = 0, crop_height = 0;  ///< crop_width 0: the whole picture
  int camera = 0;
  FrameClock clock;
  int spp = 64;
  std::uint64_t seed = 0;
  bool seed_per_frame = true;  ///< false: every frame gets the same noise pattern
  SamplerKind sampler = SamplerKind::kSobol;
  PixelFilter filter;
  std::vector<std::string> layers{"color"};  ///< requested layer names (frames/layers.h); "color" is always written
  std::vector<PathClass> classes;
  bool classes_are_decomposition = false;  ///< check disjointness, add "residual", components sum to color exactly
  int cryptomatte_depth = 6;
  /// First frames after a cut, in order: nothing looks across, so motion vectors are invalid there.
  std::vector<int> cuts;
  bool is_cut(int frame) const { return std::binary_search(cuts.begin(), cuts.end(), frame); }
  std::string canonical() const;  ///< all fields as text, for metadata and resume

  int x0() const { return crop_width > 0 ? crop_x : 0; }
  int y0() const { return crop_width > 0 ? crop_y : 0; }
  int x1() const { return crop_width > 0 ? crop_x + crop_width : width; }
  int y1() const { return crop_width > 0 ? crop_y + crop_height : height; }
};

/// What an integrator works out for a frame, and all its tiles share.
struct FramePlan {
  virtual ~FramePlan() = default;
};

/// Everything that is fixed while one frame renders (frame_scene.h makes it).
struct FrameContext {
  const Scene& scene;
  const RayScene& rays;        ///< of the first piece of the exposure between jumps
  const LightSampler& lights;  ///< likewise
  const CameraModel& camera;
  const LightPathClassifier& classifier;
  const RenderSettings& settings;
  int frame = 0;
  FramePlan* plan = nullptr;  ///< what the integrator's `prepare` returned; a tile changes nothing of another's there
  bool only_for_next_frame =
      false;  ///< only what the next frame needs (Integrator::layers_for_next_frame) is wanted of this one
  /// For each piece of the exposure what its rays and lights are; none if there is but one piece.
  std::span<const FrameContext> pieces{};

  /// This context for paths of time t (seconds): their rays meet what is there then.
  const FrameContext& at(double t) const {
    if (pieces.empty()) return *this;
    std::size_t i = 0;
    while (i + 1 < pieces.size() && t >= pieces[i + 1].rays.rays().begin) ++i;
    return pieces[i];
  }
};

/// The quantum of parallelism, checkpoint and resume: pixels [x0,x1) x [y0,y1) of the frame with all their samples.
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

class Integrator {
 public:
  virtual ~Integrator() = default;
  /// Layers that `render` will write; known before a ray is traced, so that a pipeline is checked up front.
  /// Errors: Error{kUnknownName | kUnsupported} for a requested layer that this integrator cannot write.
  virtual std::vector<LayerDesc> outputs(const RenderSettings& settings) const = 0;

  /// Layers that `render` fills beside them for `finish`, and that no file holds.
  virtual std::vector<LayerDesc> work_layers(const RenderSettings& /*settings*/) const { return {}; }

  /// How many frames before the one that is rendered `prepare` looks at: 0 or 1.
  virtual int frames_before() const { return 0; }
  /// Layers of the frame before that `prepare` needs as they were rendered.
  virtual std::vector<std::string> layers_for_next_frame() const { return {}; }
  /// Called before the tiles of a frame. `before`: the preceding frame, if frames_before() asks for it; its rays serve
  /// the middle of its exposure only. `rendered`: the layers of that frame that layers_for_next_frame() names; null if
  /// it names none, or if context.only_for_next_frame. Threads: called from one, may use parallel_for.
  virtual std::unique_ptr<FramePlan> prepare(const FrameContext& /*context*/, const FrameContext* /*before*/,
                                             const Frame* /*rendered*/) const {
    return nullptr;
  }

  /// How often `render` is called for each tile of a frame: for all tiles of a round before any of the next.
  virtual int rounds(const RenderSettings& /*settings*/) const { return 1; }
  /// Called before each round but the first, when all tiles of `out` are rendered. Threads: as `prepare`.
  virtual void next_round(const FrameContext& /*context*/, const Frame& /*out*/) const {}

  /// Writes the estimates of one tile to `out`.
  /// Shapes:  every layer of `outputs()` exists in `out` with the size of the crop window; tile coordinates are pixels
  /// of
  ///          the full picture; pixel (x, y) is stored at (x - settings.x0(), y - settings.y0()).
  /// Units:   radiance in W/(m^2 sr), scene-linear RGB; time in seconds.
  /// Result:  a function of (scene, settings, parameters, tile) alone: not of threads, order, or the split over
  /// machines. Errors:  returns early once `stop` is requested (the tile is then incomplete and must be discarded).
  /// Threads: const and re-entrant; called concurrently for disjoint tiles.
  virtual void render(const FrameContext& context, const Tile& tile, Frame& out, RenderCounters& counters,
                      std::stop_token stop) const = 0;

  /// Makes what needs neighbouring pixels of other tiles, once all tiles of a frame are rendered.
  virtual void finish(const FrameContext& /*context*/, Frame& /*out*/) const {}

  /// Renders one sample again, to look into what was wrong with it, and returns its radiance. Integrators that compute
  /// more from a sample return that if it is not finite where the radiance is. `context.plan` need not be set.
  virtual Rgb replay(const FrameContext& context, const BadSample& sample) const = 0;
};

/// Calls Integrator::finish and removes the work layers.
void finish_frame(const Integrator& integrator, const FrameContext& context, Frame& frame);

/// A frame with all layers of `integrator`, work layers too, zero, and the metadata that goes with them (cryptomatte
/// manifest).
Frame make_frame(const Integrator& integrator, const RenderSettings& settings, const Scene& scene);

/// A name that users can choose, its help line, its parameters and its factory.
struct IntegratorEntry {
  std::string name;
  std::string help;
  std::span<const ParamSpec> params;
  std::unique_ptr<Integrator> (*make)(const Params& params);
};

/// All integrators, in the order of the manual.
std::span<const IntegratorEntry* const> integrator_catalog();
/// Errors: Error{kUnknownName} at `loc` with the known names.
const IntegratorEntry& find_integrator(const std::string& name, const SourceLoc& loc = {});

}  // namespace tempera
