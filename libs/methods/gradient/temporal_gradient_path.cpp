// SPDX-License-Identifier: Apache-2.0
// Temporal gradient-domain path tracing. [Manzi 2016]
//
// Each frame is rendered twice with half of the samples: the base pass with random numbers of its own, and the offset
// pass with those of the frame before, each pixel with the numbers of the pixel that showed the same matter then. The
// difference of the offset pass of frame t + 1 and the base pass of frame t is the temporal difference (Sec. 3.2): the
// temporal shift copies all primary sample coordinates and adds a frame to the time, so its Jacobian is one.
#include <algorithm>
#include <array>
#include <cmath>

#include "gradient_pass.h"
#include "tempera/methods/method.h"
#include "tempera/methods/motion_layers.h"
#include "tempera/transport/pixel_motion.h"
#include "tempera/transport/tile_film.h"

namespace tempera {

namespace {

const std::string kOffset = "offset.";

/// Samples of the base and of the offset pass. The offset pass has as many as the base pass of the frame before.
int base_samples(const RenderSettings& s) { return s.spp - s.spp / 2; }
int offset_samples(const RenderSettings& s) { return s.spp / 2; }

struct ReplayState final : GradientState {
  ReplayState(const RenderSettings& settings, const GradientOptions& options)
      : GradientState(settings, options, base_samples(settings)) {}
  ReplayMap map;
  Image samples_before;  ///< of the base pass of the frame before; empty under uniform sampling
};

class TemporalGradientPath final : public Method {
 public:
  static const std::vector<ParamSpec>& params() {
    static const std::vector<ParamSpec> specs = [] {
      std::vector<ParamSpec> s = GradientOptions::params();
      s.push_back({"subpixel_motion", true, "replayed samples follow motion by parts of a pixel (box filter)"});
      return s;
    }();
    return specs;
  }
  explicit TemporalGradientPath(const Params& p) : options_(p), subpixel_motion_(p.get_bool("subpixel_motion")) {
    if (options_.photons) photons_.emplace(PhotonOptions(p), options_.path.max_depth);
  }

  std::vector<LayerDesc> outputs(const RenderSettings& settings) const override {
    check_gradient_settings(settings, "temporal_gradient_path");
    if (!settings.seed_per_frame) {
      throw SettingError(
          ErrorCode::kUnsupported, "sampling.seed_per_frame",
          "the integrator \"temporal_gradient_path\" replays the numbers of the frame before: every frame needs "
          "its own (sampling.seed_per_frame = true)");
    }
    if (settings.spp < 2) {
      throw SettingError(
          ErrorCode::kOutOfRange, "sampling.spp",
          "the integrator \"temporal_gradient_path\" divides the samples among two passes: spp must be at least 2");
    }
    plan_batches(options_.adaptive, base_samples(settings));
    std::vector<std::string> more = gradient_layer_names(options_, "", 1);
    for (std::string& name : gradient_layer_names(options_, kOffset, 1)) more.push_back(std::move(name));
    for (const char* name :
         {"offset.color", "offset.color.a", "offset.color.b", "offset.color.var", "offset.samples", "offset.source"})
      more.emplace_back(name);
    std::vector<LayerDesc> result = film_outputs(settings, "temporal_gradient_path", more);
    add_missing(result, gradient_outputs(options_, settings, "", false));
    add_missing(result, {layers::samples(), layers::motion_forward(), layers::motion_backward()});
    add_missing(result, gradient_outputs(options_, settings, kOffset, true));
    add_missing(result, {layers::offset(layers::samples()), layers::offset(layers::source())});
    if (options_.rare) {
      add_missing(result, rare_layers("", 1));
      add_missing(result, rare_layers(kOffset, 1));
      add_missing(result, {layers::object_id()});
    }
    return result;
  }
  std::vector<LayerDesc> work_layers(const RenderSettings& settings) const override {
    std::vector<LayerDesc> result;
    for (const std::string& prefix : {std::string(), kOffset}) {
      add_missing(result, gradient_work_layers(options_, settings, prefix));
      if (options_.rare) add_missing(result, rare_work_layers(prefix, 1));
    }
    return result;
  }

  std::vector<PassDesc> passes(const RenderSettings& settings, FrameRange /*section*/) const override {
    std::vector<PassDesc> result = GradientBatches::passes(options_, settings, base_samples(settings));
    PassDesc offset{.name = "offset", .scene = {.before = 1}};
    if (options_.adaptive.mode != AdaptiveOptions::Mode::kOff)
      offset.reads = {{layers::samples().name, -1, result.back().name}};
    result.push_back(std::move(offset));
    return photons_ ? photons_->passes(settings, result) : result;
  }
  std::vector<std::string> own_classes() const override { return photon_classes(photons_); }
  std::unique_ptr<SectionState> begin(const SceneWindow& window) const override {
    return std::make_unique<ReplayState>(window.settings(), options_);
  }
  void begin_pass(const SceneWindow& window, SectionState* state, int pass,
                  std::span<const Image> reads) const override {
    auto& replay = *static_cast<ReplayState*>(state);
    const int batch = batch_of(pass);
    if (batch < 0) return photons_->begin(window, replay.photons, 0);
    if (photons_) photons_->begin_gather(window, replay.photons);
    if (batch < replay.batches.count()) return;
    const int frame = window.section().first;
    replay.map = make_replay_map(window.middle_of_frame_before(frame), window.frame(frame));
    if (!reads.empty()) replay.samples_before = reads[0];
    prepare_motion_layers(window);
  }
  void run(const SceneWindow& window, SectionState* state, const Unit& unit, UnitOutput& out, RenderCounters& counters,
           std::stop_token stop) const override {
    const auto& replay = *static_cast<const ReplayState*>(state);
    const int batch = batch_of(unit.pass);
    if (batch < 0) {
      photons_->run(window, replay.photons, unit.number, out, counters, stop);
      return;
    }
    const FrameContext& context = window.frame(unit.frame);
    if (batch < replay.batches.count()) {
      replay.batches.render(context, options_, replay.photons.light(), batch, unit.tile, out, counters, stop);
    } else if (render_offset(context, replay, unit.tile, out.picture(), counters, stop)) {
      write_motion_layers(window, unit, out);
    }
  }
  void end_pass(const SceneWindow& window, SectionState* state, int pass, const PassResult& result) const override {
    auto& replay = *static_cast<ReplayState*>(state);
    const int batch = batch_of(pass);
    if (batch < 0) {
      photons_->end(window, replay.photons, result);
      return;
    }
    replay.batches.end(window.settings(), options_, batch, window.section().first, *result.pictures[0]);
  }
  void finish(Frame& out) const override {
    join_gradients("", out);
    join_gradients(kOffset, out);
    if (options_.rare) keep_rare_apart(std::vector<std::string>{"", kOffset}, out);
  }

  Rgb replay(const FrameContext& context, const BadSample& sample) const override {
    return replay_gradients(context, options_, sample);
  }

 private:
  /// Of the base pass, or its number of batches for the offset pass; -1 for the pass of photons.
  int batch_of(int pass) const { return photons_ ? pass - 1 : pass; }
  /// Each pixel with the numbers, and as many of them, as the pixel of the frame before that showed the same matter.
  /// Returns false if it was stopped.
  bool render_offset(const FrameContext& context, const ReplayState& state, const Tile& tile, Frame& out,
                     RenderCounters& counters, const std::stop_token& stop) const {
    const int x0 = context.settings.x0(), y0 = context.settings.y0();
    GradientTile film(context, tile, out, kOffset, state.photons.light());
    Image& source = out.layer(kOffset + "source");
    for (int y = tile.y0; y < tile.y1; ++y) {
      for (int x = tile.x0; x < tile.x1; ++x) {
        if (stop.stop_requested()) return false;
        const ReplayMap::Source& from = state.map.at(x, y);
        const int sx = from.x, sy = from.y;
        const bool replayed = sx >= 0;
        // What could not be seen before gets samples of its own: differences need samples on both sides.
        PixelKey key{stream_number(StreamPurpose::kFill, context.frame), x, y};
        if (replayed) {
          key = {context.frame - 1, sx, sy};
          key.rotation_x = rotation(context.settings.filter, from.residue.x);
          key.rotation_y = rotation(context.settings.filter, from.residue.y);
        }
        const int count = replayed && !state.samples_before.empty() ? int(state.samples_before.at(sx - x0, sy - y0))
                                                                    : offset_samples(context.settings);
        film.sample(context, options_, x, y, key, 0, count, counters);
        const std::array<float, 3> values{replayed ? float(sx) : 0, replayed ? float(sy) : 0, replayed ? 1.0f : 0.0f};
        std::copy(values.begin(), values.end(), source.pixel(x - x0, y - y0));
      }
    }
    film.write(out);
    return true;
  }

  /// How far samples are turned within the pixel to stay on the matter that they showed in the frame before: those that
  /// leave it on one side come back on the other, so that the density stays even. In units of PixelKey. Beyond [Manzi
  /// 2016], where matter moves against the pixel by what rounding leaves over. Other filters are not even: turned by
  /// what is right in their middle, samples further out stray more than without.
  int rotation(const PixelFilter& filter, float residue) const {
    if (!subpixel_motion_ || filter.kind() != FilterKind::kBox) return 0;
    return int(std::lround(residue / (2 * filter.radius()) * PixelKey::kFullRotation));
  }

  GradientOptions options_;
  std::optional<PhotonPass> photons_;
  bool subpixel_motion_;
};

}  // namespace

extern const MethodEntry temporal_gradient_path_entry;
const MethodEntry temporal_gradient_path_entry{
    "temporal_gradient_path",
    "Temporal gradient-domain path tracing: differences over space and time for `tempera reconstruct`",
    TemporalGradientPath::params(),
    [](const Params& p) -> std::unique_ptr<Method> { return std::make_unique<TemporalGradientPath>(p); }};

}  // namespace tempera
