// SPDX-License-Identifier: Apache-2.0
// Gradient-domain path tracing of single frames. [Kettunen 2015]
#include "gradient_pass.h"
#include "pixel_motion.h"
#include "tile_film.h"

namespace tempera {

namespace {

struct BatchedPlan final : FramePlan {
  BatchedPlan(const FrameContext& context, const GradientOptions& options)
      : batches(context, options, context.settings.spp) {}
  GradientBatches batches;
};

class GradientPathIntegrator final : public Integrator {
 public:
  explicit GradientPathIntegrator(const Params& p) : options_(p) {}

  std::vector<LayerDesc> outputs(const RenderSettings& settings) const override {
    check_gradient_settings(settings, "gradient_path");
    plan_batches(options_.adaptive, settings.spp);
    static const std::vector<std::string> more{"grad.x", "grad.y", "grad.x.var", "grad.y.var"};
    std::vector<LayerDesc> result = film_outputs(settings, "gradient_path", more);
    add_missing(result, {layers::grad_x(), layers::grad_y()});
    return result;
  }
  std::vector<LayerDesc> work_layers(const RenderSettings& /*settings*/) const override {
    return gradient_work_layers();
  }
  int rounds(const RenderSettings& settings) const override {
    return plan_batches(options_.adaptive, settings.spp).count;
  }
  std::unique_ptr<FramePlan> prepare(const FrameContext& context, const FrameContext* /*before*/,
                                     const Frame* /*rendered*/) const override {
    return std::make_unique<BatchedPlan>(context, options_);
  }
  void next_round(const FrameContext& context, const Frame& out) const override {
    static_cast<BatchedPlan*>(context.plan)->batches.next(context, options_, out);
  }
  void render(const FrameContext& context, const Tile& tile, Frame& out, RenderCounters& counters,
              std::stop_token stop) const override {
    GradientBatches& batches = static_cast<BatchedPlan*>(context.plan)->batches;
    if (batches.render(context, options_, tile, out, counters, stop) && batches.last())
      write_motion(context, tile, out);
  }
  void finish(const FrameContext& /*context*/, Frame& out) const override { join_gradients("", out); }

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

extern const IntegratorEntry gradient_path_entry;
const IntegratorEntry gradient_path_entry{
    "gradient_path", "Gradient-domain path tracing: the picture and the differences of its pixels",
    GradientOptions::params(),
    [](const Params& p) -> std::unique_ptr<Integrator> { return std::make_unique<GradientPathIntegrator>(p); }};

}  // namespace tempera
