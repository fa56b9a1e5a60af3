// SPDX-License-Identifier: Apache-2.0
// Gradient-domain path tracing of single frames. [Kettunen 2015]
#include "gradient_pass.h"
#include "tempera/methods/method.h"
#include "tempera/methods/motion_layers.h"
#include "tempera/transport/tile_film.h"

namespace tempera {

namespace {

class GradientPath final : public Method {
 public:
  explicit GradientPath(const Params& p) : options_(p) {
    if (options_.photons) photons_.emplace(PhotonOptions(p), options_.path.max_depth);
  }

  std::vector<LayerDesc> outputs(const RenderSettings& settings) const override {
    check_gradient_settings(settings, "gradient_path");
    plan_batches(options_.adaptive, settings.spp);
    std::vector<LayerDesc> result = film_outputs(settings, "gradient_path", gradient_layer_names(options_, "", 2));
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
  std::vector<std::string> own_classes() const override { return photon_classes(photons_); }
  std::vector<PassDesc> passes(const RenderSettings& settings, FrameRange /*section*/) const override {
    std::vector<PassDesc> result = GradientBatches::passes(options_, settings, settings.spp);
    return photons_ ? photons_->passes(settings, result) : result;
  }
  std::unique_ptr<SectionState> begin(const SceneWindow& window) const override {
    return std::make_unique<GradientState>(window.settings(), options_, window.settings().spp);
  }
  void begin_pass(const SceneWindow& window, SectionState* state, int pass,
                  std::span<const Image> /*reads*/) const override {
    PhotonState& photons = static_cast<GradientState*>(state)->photons;
    if (batch_of(pass) < 0) return photons_->begin(window, photons, 0);
    if (photons_) photons_->begin_gather(window, photons);
    prepare_motion_layers(window);
  }
  void run(const SceneWindow& window, SectionState* state, const Unit& unit, UnitOutput& out, RenderCounters& counters,
           std::stop_token stop) const override {
    const auto& gradients = *static_cast<const GradientState*>(state);
    const GradientBatches& batches = gradients.batches;
    const int batch = batch_of(unit.pass);
    if (batch < 0) {
      photons_->run(window, gradients.photons, unit.number, out, counters, stop);
      return;
    }
    const FrameContext& context = window.frame(unit.frame);
    if (batches.render(context, options_, gradients.photons.light(), batch, unit.tile, out, counters, stop) &&
        batch + 1 == batches.count()) {
      write_motion_layers(window, unit, out);
    }
  }
  void end_pass(const SceneWindow& window, SectionState* state, int pass, const PassResult& result) const override {
    auto& gradients = *static_cast<GradientState*>(state);
    const int batch = batch_of(pass);
    if (batch < 0) {
      photons_->end(window, gradients.photons, result);
      return;
    }
    gradients.batches.end(window.settings(), options_, batch, window.section().first, *result.pictures[0]);
  }
  void finish(Frame& out) const override {
    join_gradients("", out);
    if (options_.rare) keep_rare_apart(std::vector<std::string>{""}, out);
  }

  Rgb replay(const FrameContext& context, const BadSample& sample) const override {
    return replay_gradients(context, options_, sample);
  }

 private:
  /// That a pass renders; -1 for the pass of photons.
  int batch_of(int pass) const { return photons_ ? pass - 1 : pass; }

  GradientOptions options_;
  std::optional<PhotonPass> photons_;
};

}  // namespace

extern const MethodEntry gradient_path_entry;
const MethodEntry gradient_path_entry{
    "gradient_path", "Gradient-domain path tracing: the picture and the differences of its pixels",
    GradientOptions::params(),
    [](const Params& p) -> std::unique_ptr<Method> { return std::make_unique<GradientPath>(p); }};

}  // namespace tempera
