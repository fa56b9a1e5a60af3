// SPDX-License-Identifier: Apache-2.0
// Gradient-domain path tracing of single frames. [Kettunen 2015]
#include "gradient_pass.h"
#include "tempera/methods/method.h"
#include "tempera/methods/motion_layers.h"
#include "tempera/transport/tile_film.h"

namespace tempera {

namespace {

struct GradientState final : SectionState {
  GradientState(const RenderSettings& settings, const GradientOptions& options)
      : batches(settings, options, settings.spp) {}
  void save(ByteWriter& out) const override { batches.save(out); }
  void load(ByteReader& in) override { batches.load(in); }
  GradientBatches batches;
};

class GradientPath final : public Method {
 public:
  explicit GradientPath(const Params& p) : options_(p) {}

  std::vector<LayerDesc> outputs(const RenderSettings& settings) const override {
    check_gradient_settings(settings, "gradient_path");
    plan_batches(options_.adaptive, settings.spp);
    std::vector<LayerDesc> result = film_outputs(settings, "gradient_path", gradient_layer_names("", 2));
    add_missing(result, gradient_outputs(options_, settings, "", false));
    if (options_.rare) {
      add_missing(result, rare_layers("", 2));
      add_missing(result, {layers::samples(), layers::object_id()});
    }
    return result;
  }
  std::vector<LayerDesc> work_layers(const RenderSettings& settings) const override {
    std::vector<LayerDesc> result = gradient_work_layers(options_, settings, "");
    if (options_.rare) add_missing(result, rare_work_layers("", 2));
    return result;
  }
  std::vector<PassDesc> passes(const RenderSettings& settings, FrameRange /*section*/) const override {
    return GradientBatches::passes(options_, settings, settings.spp);
  }
  std::unique_ptr<SectionState> begin(const SceneWindow& window) const override {
    return std::make_unique<GradientState>(window.settings(), options_);
  }
  void begin_pass(const SceneWindow& window, SectionState* /*state*/, int /*pass*/,
                  std::span<const Image> /*reads*/) const override {
    prepare_motion_layers(window);
  }
  void run(const SceneWindow& window, SectionState* state, const Unit& unit, UnitOutput& out, RenderCounters& counters,
           std::stop_token stop) const override {
    const FrameContext& context = window.frame(unit.frame);
    const GradientBatches& batches = static_cast<const GradientState*>(state)->batches;
    if (batches.render(context, options_, unit.pass, unit.tile, out, counters, stop) &&
        unit.pass + 1 == batches.count()) {
      write_motion_layers(window, unit, out);
    }
  }
  void end_pass(const SceneWindow& window, SectionState* state, int pass, const PassResult& result) const override {
    static_cast<GradientState*>(state)->batches.end(window.settings(), options_, pass, window.section().first,
                                                    *result.pictures[0]);
  }
  void finish(Frame& out) const override {
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

extern const MethodEntry gradient_path_entry;
const MethodEntry gradient_path_entry{
    "gradient_path", "Gradient-domain path tracing: the picture and the differences of its pixels",
    GradientOptions::params(),
    [](const Params& p) -> std::unique_ptr<Method> { return std::make_unique<GradientPath>(p); }};

}  // namespace tempera
