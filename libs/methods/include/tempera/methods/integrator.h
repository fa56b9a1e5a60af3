// SPDX-License-Identifier: Apache-2.0
#pragma once
// An integrator estimates light transport and writes named layers. It owns no threads and no files: the pipeline cuts a
// shot into work units (tiles of a frame), runs them in any order and writes the frames.
#include <memory>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "tempera/core/params.h"
#include "tempera/frames/frame.h"
#include "tempera/frames/layers.h"
#include "tempera/transport/frame_context.h"

namespace tempera {

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
