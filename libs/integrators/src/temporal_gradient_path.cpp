// SPDX-License-Identifier: Apache-2.0
// Temporal gradient-domain path tracing. [Manzi 2016]
//
// Each frame is rendered twice with half of the samples: the base pass with random numbers of its own, and the offset
// pass with those of the frame before, each pixel with the numbers of the pixel that showed the same matter then. The
// difference of the offset pass of frame t + 1 and the base pass of frame t is the temporal difference (Sec. 3.2): the
// temporal shift copies all primary sample coordinates and adds a frame to the time, so its Jacobian is one.
#include <fmt/format.h>

#include "gradient_pass.h"
#include "pixel_motion.h"
#include "tile_film.h"

namespace tempera {

namespace {

const std::string kOffset = "offset.";
/// Streams of pixels that show what the frame before did not: independent of all frames' own.
constexpr std::int64_t kFillStreams = std::int64_t(1) << 40;

struct ReplayPlan final : FramePlan {
  ReplayMap map;
};

class TemporalGradientPathIntegrator final : public Integrator {
 public:
  explicit TemporalGradientPathIntegrator(const Params& p) : options_(p) {}

  std::vector<LayerDesc> outputs(const RenderSettings& settings) const override {
    check_gradient_settings(settings, "temporal_gradient_path");
    if (!settings.seed_per_frame) {
      throw Error(
          ErrorCode::kUnsupported,
          "the integrator \"temporal_gradient_path\" replays the numbers of the frame before: every frame needs "
          "its own (sampling.seed_per_frame = true)");
    }
    if (settings.spp < 2) {
      throw Error(
          ErrorCode::kOutOfRange,
          "the integrator \"temporal_gradient_path\" divides the samples among two passes: spp must be at least 2");
    }
    static const std::vector<std::string> more = [] {
      std::vector<std::string> names;
      for (const char* prefix : {"", "offset."}) {
        for (const char* name : {"grad.x", "grad.y", "grad.x.var", "grad.y.var"})
          names.push_back(std::string(prefix) + name);
      }
      for (const char* name :
           {"offset.color", "offset.color.a", "offset.color.b", "offset.color.var", "offset.samples", "offset.source"})
        names.push_back(name);
      return names;
    }();
    std::vector<LayerDesc> result = film_outputs(settings, "temporal_gradient_path", more);
    add_missing(result, {layers::grad_x(), layers::grad_y(), layers::samples(), layers::motion_forward(),
                         layers::motion_backward(), layers::offset(layers::color()), layers::offset(layers::grad_x()),
                         layers::offset(layers::grad_y()), layers::offset(layers::samples()),
                         layers::offset(layers::source())});
    return result;
  }
  std::vector<LayerDesc> work_layers(const RenderSettings& /*settings*/) const override {
    std::vector<LayerDesc> result = gradient_work_layers();
    for (LayerDesc& d : gradient_work_layers(kOffset)) result.push_back(std::move(d));
    return result;
  }

  int frames_before() const override { return 1; }
  std::unique_ptr<FramePlan> prepare(const FrameContext& context, const FrameContext* before) const override {
    auto plan = std::make_unique<ReplayPlan>();
    plan->map = make_replay_map(*before, context);
    return plan;
  }

  void render(const FrameContext& context, const Tile& tile, Frame& out, RenderCounters& counters,
              std::stop_token stop) const override {
    const ReplayMap& map = static_cast<const ReplayPlan&>(*context.plan).map;
    const int offset_spp = context.settings.spp / 2, base_spp = context.settings.spp - offset_spp;
    const auto own = [&](int x, int y) { return own_key(context, x, y); };
    const auto replayed = [&](int x, int y) -> PixelKey {
      const auto& [sx, sy] = map.at(x, y);
      if (sx < 0) return {context.frame + kFillStreams, x, y};
      return {context.frame - 1, sx, sy};
    };
    if (!gradient_pass(context, options_, tile, base_spp, own, "", out, counters, stop)) return;
    if (!gradient_pass(context, options_, tile, offset_spp, replayed, kOffset, out, counters, stop)) return;
    write_motion(context, tile, out);
    Image& source = out.layer(kOffset + "source");
    for (int y = tile.y0; y < tile.y1; ++y) {
      for (int x = tile.x0; x < tile.x1; ++x) {
        const int ox = x - context.settings.x0(), oy = y - context.settings.y0();
        const auto& [sx, sy] = map.at(x, y);
        source.at(ox, oy, 0) = sx < 0 ? 0.0f : float(sx);
        source.at(ox, oy, 1) = sx < 0 ? 0.0f : float(sy);
        source.at(ox, oy, 2) = sx < 0 ? 0.0f : 1.0f;
      }
    }
  }
  void finish(const FrameContext& /*context*/, Frame& out) const override {
    join_gradients("", out);
    join_gradients(kOffset, out);
  }

  Rgb replay(const FrameContext& context, int x, int y, int sample) const override {
    const CameraSample camera = camera_sample(context, x, y, sample);
    std::vector<Rgb> classes(context.settings.classes.empty() ? 0 : context.settings.classes.size() + 1);
    NoObserver none;
    return trace_path(context, options_.path, camera, {}, classes, false, none).radiance * camera.weight;
  }

 private:
  GradientOptions options_;
};

}  // namespace

extern const IntegratorEntry temporal_gradient_path_entry;
const IntegratorEntry temporal_gradient_path_entry{
    "temporal_gradient_path",
    "Temporal gradient-domain path tracing: differences over space and time for `tempera reconstruct`",
    GradientOptions::params(),
    [](const Params& p) -> std::unique_ptr<Integrator> { return std::make_unique<TemporalGradientPathIntegrator>(p); }};

}  // namespace tempera
