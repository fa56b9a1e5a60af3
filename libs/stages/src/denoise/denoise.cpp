// SPDX-License-Identifier: Apache-2.0
// The stage `denoise`: clean frames without flicker from noisy ones, see docs/denoising.md.
#include <fmt/format.h>

#include <algorithm>

#include "decomposition.h"
#include "denoise/denoiser.h"
#include "denoise/published.h"
#include "tempera/core/log.h"

namespace tempera {

namespace {

using denoise::Available;
using denoise::Decomposed;
using denoise::Denoiser;
using denoise::FrameByFrame;
using denoise::Method;
using denoise::Settings;

const std::vector<ParamSpec> kParams = {
    {.name = "method",
     .fallback = std::string("nl_means"),
     .help = "denoiser of single frames: nl_means; oidn (Open Image Denoise); auto, which is oidn where it is "
             "installed; or, "
             "to compare with, all that papers do: published (Zimmer et al. 2015), rmz13 (Rousselle et al. 2013)",
     .choices = {"nl_means", "oidn", "auto", "published", "rmz13"}},
    {.name = "recipe",
     .fallback = std::string("auto"),
     .help =
         "what is denoised: single, the mean of all samples; halves, each half of them; components, the same by class "
         "of light paths as far as that gains; classes, each class by itself and along the vectors of what it is seen "
         "on, all of which are written; auto goes by the number of samples",
     .choices = {"auto", "single", "halves", "components", "classes"}},
    {"radius", 2, "frames before and after that are averaged along motion; 0: each frame alone", 0, 4},
    {"cuts", std::string(), "first frames of new shots, e.g. 25,61, where motion vectors do not say so"},
    {.name = "fireflies",
     .fallback = std::string("auto"),
     .help =
         "hold brings what outshines the other half of the samples 4 times down to that; auto: with oidn, which copes "
         "with most, 64 times",
     .choices = {"auto", "hold", "keep"}},
    {.name = "residuals",
     .fallback = std::string("yes"),
     .help = "whether what both halves of the samples miss in the clean picture is given back",
     .choices = {"yes", "no"}},
    {"oidn", std::string(),
     "file of Open Image Denoise; else TEMPERA_OIDN, else libOpenImageDenoise.so.2 of the system, else of the folder "
     "../lib beside the program"},
    {"oidn_version", std::string(), "refuse any other version of it, e.g. 2.5.1"},
};

class Denoise final : public Stage {
 public:
  explicit Denoise(const Params& params) : settings_(params) {}

  SequenceDesc output(std::span<const SequenceDesc> in) const override {
    SequenceDesc out = in[0];
    const std::vector<std::string> clean =
        settings_.recipe == denoise::Recipe::kClasses ? Available(in[0].layers).classes : std::vector<std::string>{};
    std::erase_if(out.layers, [&](const LayerDesc& d) { return !survives(d, clean); });
    return out;
  }

  std::vector<LayerUse> reads(int /*port*/, std::span<const SequenceDesc> in) const override {
    std::vector<LayerUse> out{{layers::color(), true, "there is nothing to denoise"}};
    const Available available(in[0].layers);
    const bool published = settings_.method == Method::kPublished, rmz13 = settings_.method == Method::kRmz13;
    const bool any_chain = available.any_chain && !published && !rmz13;
    if (available.albedo || !any_chain) out.push_back({layers::albedo(), false});
    for (const LayerDesc& d : {layers::color_a(), layers::color_b(), layers::normal(), layers::emission(),
                               layers::object_id(), layers::motion_forward(), layers::motion_backward()}) {
      out.push_back({d, false});
    }
    if (!available.halves) out.push_back({layers::color_variance(), false});
    if (!published && !rmz13 && settings_.recipe != denoise::Recipe::kComponents &&
        settings_.recipe != denoise::Recipe::kClasses) {
      for (const LayerDesc& d : {layers::photon_color(), layers::photon_a(), layers::photon_b()})
        out.push_back({d, false});
    }
    if (rmz13) {
      out.push_back({layers::depth(), false});
      return out;
    }
    const bool by_class = settings_.recipe == denoise::Recipe::kClasses;
    std::vector<std::string> chains = available.chains;
    if (by_class && !available.classes.empty()) {  // a shot can have them rendered
      for (const std::string chain : layers::kCommonChains) {
        if (std::find(chains.begin(), chains.end(), chain) == chains.end()) chains.push_back(chain);
      }
    }
    if (any_chain && !by_class) chains.push_back(layers::kAnyChain);
    for (const std::string& chain : chains) {
      const auto add = [&](const LayerDesc& d) { out.push_back({layers::chain_layer(chain, d), false}); };
      add(layers::albedo()), add(layers::normal());
      if (published) add(layers::object_id());
      if (!by_class || chain == "D" || layers::chain_motion().empty()) continue;
      add(layers::motion_forward()), add(layers::motion_backward());
    }
    const bool automatic = settings_.recipe == denoise::Recipe::kAuto && settings_.method != denoise::Method::kNlMeans;
    if (published || by_class || settings_.recipe == denoise::Recipe::kComponents || automatic) {
      for (const std::string& name : available.classes) {
        for (const LayerDesc& d : {layers::color(), layers::color_a(), layers::color_b()})
          out.push_back({layers::class_layer(name, d), false});
      }
    }
    return out;
  }

  std::vector<int> inputs(int /*port*/, int frame, std::span<const SequenceDesc> in) const override {
    const int radius = Available(in[0].layers).motion ? settings_.radius : 0;
    // Averages before and after the denoiser, and the frames that it looks at itself.
    int distance = radius > 0 ? 2 * radius + 1 : 0;
    if (settings_.method == Method::kPublished) distance = std::min(radius, 1);
    if (settings_.method == Method::kRmz13) distance = 0;
    const FrameRange range = denoise::shot_around(frame, distance, in[0].reach, settings_.cuts);
    return frames_around(frame, frame - range.first, range.last - frame, in[0]);
  }

  void run(StageRun& run) const override {
    if (run.frames().empty()) return;
    const bool alone = settings_.radius == 0 || settings_.method == Method::kRmz13;
    for (const std::string& loss : Available(run.in()[0].layers).losses(alone)) log_info(loss);
    if (settings_.method == Method::kRmz13) return run_with(FrameByFrame(run), run);
    if (settings_.method == Method::kPublished) return run_with(Decomposed(run, settings_), run);
    run_with(Denoiser(run, settings_, oidn()), run);
  }

  std::string engine() const override {
    if (settings_.method == Method::kRmz13) return "rmz13";
    if (settings_.method == Method::kPublished) return "published";
    return denoise::describe_method(oidn().get());
  }

 private:
  template <class Driver>
  static void run_with(Driver denoiser, StageRun& run) {
    double done = 0;
    for (const int f : run.frames()) {
      run.write(f, denoiser.make(f));
      run.progress(++done / double(run.frames().size()));
    }
    for (std::string& note : denoiser.notes()) run.note(std::move(note));
    if (const std::string costs = denoiser.costs(); !costs.empty()) log_debug(costs);
  }

  /// Statistics and parts of the noisy picture are not those of the clean one.
  static bool survives(const LayerDesc& d, std::span<const std::string> clean_classes) {
    const bool clean = std::find(clean_classes.begin(), clean_classes.end(), d.path_class) != clean_classes.end();
    if (clean && is_class_color(d)) return true;
    return d.pass.empty() && d.path_class.empty() && d.role != LayerRole::kStatistic &&
           d.role != LayerRole::kReconstruction;
  }

  /// Chosen once: all frames of a run are made by the same one.
  const std::shared_ptr<denoise::Oidn>& oidn() const {
    if (!chosen_) chosen_ = denoise::choose_method(settings_);
    return *chosen_;
  }

  Settings settings_;
  mutable std::optional<std::shared_ptr<denoise::Oidn>> chosen_;
};

}  // namespace

denoise::Settings::Settings(const Params& params)
    : oidn_path(params.get_string("oidn")),
      oidn_version(params.get_string("oidn_version")),
      residuals(params.get_string("residuals") == "yes"),
      radius(params.get_int("radius")) {
  const auto is = [&](const char* param, const char* value) { return params.get_string(param) == value; };
  method = is("method", "auto")        ? Method::kAuto
           : is("method", "oidn")      ? Method::kOidn
           : is("method", "published") ? Method::kPublished
           : is("method", "rmz13")     ? Method::kRmz13
                                       : Method::kNlMeans;
  recipe = is("recipe", "single")       ? Recipe::kSingle
           : is("recipe", "halves")     ? Recipe::kHalves
           : is("recipe", "components") ? Recipe::kComponents
           : is("recipe", "classes")    ? Recipe::kClasses
                                        : Recipe::kAuto;
  if (!is("fireflies", "auto")) hold_fireflies = is("fireflies", "hold");
  if (method == Method::kPublished || method == Method::kRmz13) {
    for (const char* param : {"recipe", "fireflies"}) {
      if (!is(param, "auto"))
        throw StageParamError(ErrorCode::kUsage, {param, "method"},
                              fmt::format("{} is for method nl_means, oidn or auto; {} does what its paper does", param,
                                          params.get_string("method")));
    }
  }
  if (method != Method::kOidn && method != Method::kAuto && (!oidn_path.empty() || !oidn_version.empty())) {
    throw StageParamError(ErrorCode::kUsage, {oidn_path.empty() ? "oidn_version" : "oidn", "method"},
                          "oidn and oidn_version are for method oidn or auto");
  }
  if (const std::string& text = params.get_string("cuts"); !text.empty()) {
    try {
      cuts = parse_frame_set(text);
    } catch (const Error& e) {
      throw StageParamError(e.code(), {"cuts"}, "cuts: " + e.message());
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
              {{"motion.forward", "motion.backward"}, "needed together, for averages over time"},
              {{"class.*"},
               "light by class of paths, with the halves of each, of a decomposition, as the recipe needs them"},
              {{"chain.*"},
               "`albedo` and `normal` of what is seen in mirrors and behind glass, by their letters; `object_id` for "
               "method published"},
              {{"photon.color", "photon.color.a", "photon.color.b"},
               "light of photons, which passes as it is with recipe single or halves"},
              {{"depth"}, "for method rmz13"}},
    .writes = {{{"color"}, "the clean picture, with the input's alpha"}},
    .window =
        "`2 radius + 1` of them before and after it (method published: one, rmz13: none), up to the next cut, if "
        "they have motion vectors",
    .gap_help = "what they show is part of the averages over time (give --radius 0 to denoise each frame alone)",
    .examples = {"tempera denoise out/frame.####.exr -o final/frame.####.exr",
                 "tempera denoise out/ -o final/ --frames 1-24 --resume   (the same bits as all at once)",
                 "tempera denoise out/ -o final/ --method oidn --oidn /opt/oidn/lib/libOpenImageDenoise.so.2",
                 "tempera denoise still.exr -o clean.exr"},
    .make = [](const Params& p) -> std::unique_ptr<Stage> { return std::make_unique<Denoise>(p); }};

}  // namespace tempera
