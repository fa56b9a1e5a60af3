// SPDX-License-Identifier: Apache-2.0
// Gradient-domain path tracing of single frames. [Kettunen 2015]
#include "gradient_pass.h"
#include "tempera/methods/integrator.h"
#include "tempera/transport/pixel_motion.h"
#include "tempera/transport/tile_film.h"

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
    std::vector<LayerDesc> result = film_outputs(settings, "gradient_path", gradient_layer_names("", 2));
    add_missing(result, {layers::grad_x(), layers::grad_y()});
    if (options_.rare) {
      add_missing(result, rare_layers("", 2));
      add_missing(result, {layers::samples(), layers::object_id()});
    }
    return result;
  }
  std::vector<LayerDesc> work_layers(const RenderSettings& settings) const override {
    std::vector<LayerDesc> result = gradient_work_layers("", needs_variance(options_, settings, ""));
    if (options_.rare) add_missing(result, rare_work_layers("", 2));
    return result;
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
  void finish(const FrameContext& /*context*/, Frame& out) const override {
    join_gradients("", out);
    if (options_.rare) keep_rare_apart(std::vector<std::string>{""}, out);
  }

  Rgb replay(const FrameContext& context, const BadSample& sample) const override {
    return replay_gradients(context, options_, sample);
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
