// SPDX-License-Identifier: Apache-2.0
// The stage `denoise`: clean frames without flicker from noisy ones, see docs/denoising.md.
#include <fmt/format.h>

#include <algorithm>

#include "denoise/denoiser.h"
#include "tempera/core/log.h"

namespace tempera {

namespace {

using denoise::Available;
using denoise::Denoiser;
using denoise::Settings;

const std::vector<ParamSpec> kParams = {
    {.name = "method",
     .fallback = std::string("nl_means"),
     .help = "denoiser of single frames: nl_means, oidn (Open Image Denoise)",
     .choices = {"nl_means", "oidn"}},
    {.name = "recipe",
     .fallback = std::string("auto"),
     .help = "auto, single (the halves of the samples together) or halves (each)",
     .choices = {"auto", "single", "halves", "components"}},
    {.name = "fireflies",
     .fallback = std::string("hold"),
     .help = "keep, hold",
     .choices = {"keep", "hold"}},
    {"residuals", true, "residuals"},
    {"no_residuals", false, "none"},
    {"radius", 2, "frames before and after that are averaged along motion; 0: each frame alone", 0, 4},
    {"cuts", std::string(), "first frames of new shots, e.g. 25,61, where motion vectors do not say so"},
    {"oidn", std::string(), "file of Open Image Denoise [TEMPERA_OIDN, else libOpenImageDenoise.so.2]"},
};

class Denoise final : public Stage {
 public:
  explicit Denoise(const Params& params) : settings_(params) {}

  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    SequenceDesc out = in[0];
    std::erase_if(out.layers, [](const LayerDesc& d) { return !survives(d); });
    return out;
  }

  std::vector<LayerUse> reads(int /*port*/, std::span<const SequenceDesc> in) const override {
    std::vector<LayerUse> out{{layers::color(), true, "there is nothing to denoise"}};
    for (const LayerDesc& d :
         {layers::color_a(), layers::color_b(), layers::color_variance(), layers::albedo(), layers::normal(),
          layers::emission(), layers::object_id(), layers::motion_forward(), layers::motion_backward()}) {
      out.push_back({d, false});
    }
    if (settings_.recipe == denoise::Recipe::kComponents) {
      for (const LayerDesc& d : in[0].layers) {
        if (d.name.starts_with("chain.")) out.push_back({d, false});
      }
      for (const std::string& name : Available(in[0].layers).classes) {
        for (const LayerDesc& d : {layers::color(), layers::color_a(), layers::color_b()})
          out.push_back({layers::class_layer(name, d), false});
      }
    }
    return out;
  }

  std::vector<int> inputs(int /*port*/, int frame, std::span<const SequenceDesc> in) const override {
    // Averages before and after the denoiser, and the frames that it looks at itself.
    const int radius = Available(in[0].layers).motion ? settings_.radius : 0;
    const FrameRange range =
        denoise::shot_around(frame, radius > 0 ? 2 * radius + 1 : 0, in[0].reach, settings_.cuts);
    return frames_around(frame, frame - range.first, range.last - frame, in[0]);
  }

  void run(StageRun& run) const override {
    if (run.frames().empty()) return;
    for (const std::string& loss : Available(run.in()[0].layers).losses(settings_.radius == 0)) log_info(loss);
    Denoiser denoiser(run, settings_);
    double done = 0;
    for (const int f : run.frames()) {
      denoiser.forget_before(f);
      Frame out = run.start(f);
      denoiser.make(f, out);
      run.write(f, std::move(out));
      run.progress(++done / double(run.frames().size()));
    }
    log_debug(denoiser.costs());
  }

 private:
  /// Statistics and parts of the noisy picture are not those of the clean one.
  static bool survives(const LayerDesc& d) {
    return d.pass.empty() && d.path_class.empty() && d.role != LayerRole::kStatistic &&
           d.role != LayerRole::kReconstruction;
  }

  Settings settings_;
};

}  // namespace

denoise::Settings::Settings(const Params& params)
    : oidn(params.get_string("method") == "oidn"),
      oidn_path(params.get_string("oidn")),
      residuals(!params.get_bool("no_residuals")),
      hold_fireflies(params.get_string("fireflies") == "hold"),
      radius(params.get_int("radius")) {
  const std::string& name = params.get_string("recipe");
  recipe = name == "single" ? Recipe::kSingle : name == "halves" ? Recipe::kHalves : name == "components" ? Recipe::kComponents : Recipe::kAuto;
  if (const std::string& text = params.get_string("cuts"); !text.empty()) {
    try {
      cuts = parse_frame_set(text);
    } catch (const Error& e) {
      throw StageParamError(ErrorCode::kBadInput, {"cuts"}, e.message());
    }
  }
}

extern const StageEntry denoise_entry;
const StageEntry denoise_entry{
    .name = "denoise",
    .help = "clean frames without flicker from noisy ones",
    .command_help = "Denoise frames, with what the frames around show of the same.",
    .done = "denoised",
    .params = kParams,
    .ports = {{"in", "noisy frames"}},
    .output_help = "clean frames",
    .reads = {{{"color"}, "needed: the noisy picture"},
              {{"color.a", "color.b"}, "halves of its samples, which tell noise from picture"},
              {{"color.var"}, "its variance, where there are no halves"},
              {{"albedo", "normal", "emission", "object_id"}, "what is seen, without noise"},
              {{"motion.forward", "motion.backward"}, "needed together, for averages over time"}},
    .writes = {{{"color"}, "the clean picture, with the input's alpha"}},
    .window = "`2 radius + 1` of them before and after it, up to the next cut, if they have motion vectors",
    .gap_help = "what they show is part of the averages over time (give --radius 0 to denoise each frame alone)",
    .examples = {"tempera denoise out/frame.####.exr -o final/frame.####.exr",
                 "tempera denoise out/ -o final/ --frames 1-24 --resume   (the same bits as all at once)",
                 "tempera denoise out/ -o final/ --method oidn", "tempera denoise still.exr -o clean.exr"},
    .make = [](const Params& p) -> std::unique_ptr<Stage> { return std::make_unique<Denoise>(p); }};

}  // namespace tempera
