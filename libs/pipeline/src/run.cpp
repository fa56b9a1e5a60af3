// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/run.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <limits>
#include <set>

#include "hash.h"
#include "quality.h"
#include "tempera/frames/frame.h"
#include "tempera/stages/stage_plan.h"

namespace tempera {

namespace {

namespace fs = std::filesystem;

/// "out/f.mp4" for "out/f.####.exr".
fs::path default_movie(const fs::path& pattern, const char* extension) {
  const std::string name = pattern.filename().string();
  std::string stem = has_frame_pattern(name) ? name.substr(0, find_frame_place(name).begin) : pattern.stem().string();
  while (!stem.empty() && std::string_view("._-").find(stem.back()) != std::string_view::npos) stem.pop_back();
  return pattern.parent_path() / ((stem.empty() ? "movie" : stem) + extension);
}

fs::path with_range(const fs::path& movie, const std::vector<int>& frames) {
  const auto [first, last] = std::minmax_element(frames.begin(), frames.end());
  return movie.parent_path() /
         fmt::format("{}.{}-{}{}", movie.stem().string(), *first, *last, movie.extension().string());
}

/// How frames with this layer can be had, as the end of a sentence; empty if nothing writes it.
std::string how_to_get(const LayerDesc& layer, const Shot& shot) {
  const auto writes = [&](const std::string& integrator, const Params& params, bool asked) {
    RenderSettings settings = shot.settings;
    if (asked) settings.layers.push_back(layer.name);
    try {
      const std::vector<LayerDesc> all = rendered_layers(integrator, params, settings);
      return std::any_of(all.begin(), all.end(), [&](const LayerDesc& d) { return d.name == layer.name; });
    } catch (const Error&) {
      return false;
    }
  };
  if (writes(shot.integrator, shot.params, true)) return "name it in output.layers";
  std::vector<std::string> who;
  for (const MethodEntry* e : method_catalog()) {
    if (!writes(e->name, Params(e->params), false)) continue;
    who.push_back(fmt::format("the integrator {}{}", e->name, e->name == shot.integrator ? " by default" : ""));
  }
  for (const StageEntry* e : stage_catalog()) {
    const auto wrote = [&](const LayerHelp& h) {
      return std::find(h.layers.begin(), h.layers.end(), layer.name) != h.layers.end();
    };
    if (std::any_of(e->writes.begin(), e->writes.end(), wrote)) who.push_back(fmt::format("the stage {}", e->name));
  }
  return who.empty() ? "nothing writes it" : fmt::format("{} would write it", fmt::join(who, " or "));
}

/// The parts of the sequence that the frames asked for are made in, and which of them in each. `halo`: see Shot.
std::vector<StageSection> sections_of(std::vector<int> frames, const FrameRange& sequence, int halo) {
  std::sort(frames.begin(), frames.end());
  if (halo < 0) return {{frames, sequence, sequence}};
  std::vector<StageSection> out;
  for (const int f : frames) {
    const auto within = [&](std::int64_t g) { return int(std::clamp<std::int64_t>(g, sequence.first, sequence.last)); };
    const FrameRange reach{within(std::int64_t(f) - halo), within(std::int64_t(f) + halo)};
    if (out.empty() || out.back().reach->last + 1 < reach.first) out.push_back({{}, sequence, reach});
    out.back().reach->last = reach.last;
    out.back().frames.push_back(f);
  }
  return out;
}

HaloLoss halo_loss(std::span<const StageChoice> chain, SequenceDesc source, const std::vector<StageSection>& sections) {
  HaloLoss loss;
  source.reach = source.sequence;
  std::set<int> left_out;
  for (const StageSection& s : sections) {
    for (const int f : s.frames) {
      std::vector<int> beyond = plan_stages(chain, source, std::span(&f, 1)).source;
      std::erase_if(beyond, [&](int g) { return s.reach->contains(g); });
      if (!beyond.empty()) loss.differing.push_back(f);
      left_out.insert(beyond.begin(), beyond.end());
    }
  }
  loss.left_out.assign(left_out.begin(), left_out.end());
  for (const int g : left_out) {
    int nearest = std::numeric_limits<int>::max();
    for (const StageSection& s : sections) {
      for (const int f : s.frames) nearest = std::min(nearest, std::abs(f - g));
    }
    loss.enough = std::max(loss.enough, nearest);
  }
  return loss;
}

/// Where the frames of each step go. `steps`: those of the plan. What a stage is asked to leave somewhere is filled, if
/// it writes a mask; what it wrote and the pixels that it lacked are beside it.
void plan_places(const ShotConfig& config, const Shot& shot, std::span<const StageStep> steps, RunPlan& plan) {
  const fs::path rendered = plan.render.output;
  const std::string name = rendered.filename().string();
  if (plan.render.frames.size() > 1) plan.render.output = numbered_pattern(plan.render.output);
  std::vector<std::string> places{plan.render.output};
  if (plan.guides) {
    plan.guides->output = (rendered.parent_path() / "guides" / name).string();
    if (plan.guides->frames.size() > 1) plan.guides->output = numbered_pattern(plan.guides->output);
    places.push_back(plan.guides->output);
  }
  for (std::size_t i = 0; i < plan.stages.size(); ++i) {
    RunStage& stage = plan.stages[i];
    const ShotStage& asked = shot.stages[steps[i].asked];
    const std::string& own = asked.choice.entry->name;
    const std::string key = own + ".path";
    const auto beside = [&](const std::string& folder) { return (rendered.parent_path() / folder / name).string(); };
    const auto put = [&](std::string& output, std::string place) {
      output = stage.frames.size() > 1 ? numbered_pattern(place) : std::move(place);
      for (const std::string& other : places) {
        if (fs::absolute(output).lexically_normal() != fs::absolute(other).lexically_normal()) continue;
        throw Error(ErrorCode::kBadInput, config.loc(key),
                    fmt::format("the {} {} would replace those that they are made of; name another place",
                                asked.choice.entry->output_help, output));
      }
      places.push_back(output);
    };
    if (stage.pixels) {
      stage.pixels->mask = plan.stages[i - 1].output;
      put(stage.pixels->output, beside(own + ".pixels"));
    }
    if (i + 1 < steps.size() && steps[i + 1].fills()) {
      put(stage.output, beside(own + ".masked"));
    } else {
      put(stage.output, asked.path.empty() ? beside(i + 1 == plan.stages.size() ? "final" : own)
                                           : settle_output(config, shot, key, name));
    }
  }
  plan.output = plan.stages.back().output;
}

/// Lets `s` render pictures, or a crop window, of that size. Returns whether it can: false for a window that lies between
/// pixels then.
bool resize(int width, int height, RenderSettings& s) {
  if (s.crop_width == 0) {
    s.width = width, s.height = height;
    return true;
  }
  const auto scale = [](int& value, int to, int from) {
    const std::int64_t scaled = std::int64_t(value) * to;
    value = int(scaled / from);
    return scaled % from == 0;
  };
  const int w = s.crop_width, h = s.crop_height;
  bool whole = true;
  for (int* v : {&s.width, &s.crop_x, &s.crop_width}) whole &= scale(*v, width, w);
  for (int* v : {&s.height, &s.crop_y, &s.crop_height}) whole &= scale(*v, height, h);
  return whole;
}

/// What renders guides: the shot with few samples, and more of those that see features alone where the integrator can.
Shot guide_shot(const Shot& shot, const std::set<int>& frames, const WriteOptions& write) {
  Shot guides = shot;
  guides.frames.assign(frames.begin(), frames.end());
  guides.write = write;
  guides.settings.spp = std::min(shot.settings.spp, shot.guide_spp);
  constexpr const char* kFeatures = "feature_samples";
  if (guides.params.has(kFeatures))
    guides.params.set(kFeatures, std::max(guides.params.get_int(kFeatures), kGuideFeatureSamples));
  return guides;
}

/// What renders pixels for `step`, which fills them in: the shot, at the size of the step's frames. Errors:
/// Error{kUnsupported | kBadInput} where the integrator or the crop window does not let it.
Shot pixel_shot(const ShotConfig& config, const Shot& shot, const StageStep& step) {
  const std::string& who = shot.stages[step.asked].choice.entry->name;
  if (!shot.mask.empty()) {
    throw Error(
        ErrorCode::kBadInput, config.loc("film.mask"),
        fmt::format("the stage {} has pixels rendered by a mask of its own: a shot with it takes no other", who));
  }
  const auto fail = [&](ErrorCode code, const std::string& why) {
    throw Error(code, stages_loc(config, step.asked),
                fmt::format("the stage {} has single pixels rendered, {}", who, why));
  };
  if (!find_method(shot.integrator).make(shot.params)->renders_single_pixels()) {
    fail(ErrorCode::kUnsupported,
         fmt::format("but the integrator \"{}\" with these parameters renders whole pictures alone", shot.integrator));
  }
  Shot pixels = shot;
  const int width = step.out.width, height = step.out.height;
  if (!resize(width, height, pixels.settings)) {
    fail(ErrorCode::kBadInput, fmt::format("{}x{} of a crop window of {}x{}, which lies between pixels at that size",
                                           width, height, shot.settings.crop_width, shot.settings.crop_height));
  }
  return pixels;
}

/// `layers`: of the rendered frames. Returns those of the result.
std::vector<LayerDesc> plan_the_stages(const ShotConfig& config, const Shot& shot, std::vector<LayerDesc> layers,
                                       RunPlan& plan) {
  const auto [first, last] = std::minmax_element(shot.frames.begin(), shot.frames.end());
  SequenceDesc source;
  source.sequence = {std::min(*first, shot.sequence.first), std::max(*last, shot.sequence.last)};
  source.width = shot.settings.crop_width > 0 ? shot.settings.crop_width : shot.settings.width;
  source.height = shot.settings.crop_width > 0 ? shot.settings.crop_height : shot.settings.height;
  source.layers = std::move(layers);
  if (source.sequence != shot.sequence) {
    log_warning(
        fmt::format("the shot has frames {}-{}: as others were asked for, {}-{} are taken for the sequence, and "
                    "frames near its ends differ from those of the shot alone",
                    shot.sequence.first, shot.sequence.last, source.sequence.first, source.sequence.last));
  }
  std::vector<StageChoice> chain;
  for (const ShotStage& s : shot.stages) chain.push_back(s.choice);
  // The files between steps are read by stages: under our names, and without loss. What was asked for holds for the
  // result.
  WriteOptions between = shot.write;
  between.names = AovNames::kTempera, between.half = false;
  if (between.compression == Compression::kDwaa) between.compression = Compression::kZip;
  plan.render.write.names = AovNames::kTempera;
  if (plan.render.write.compression == Compression::kDwaa) plan.render.write.compression = Compression::kZip;

  const std::vector<StageSection> sections = sections_of(shot.frames, source.sequence, shot.halo);
  std::set<int> rendered, guides;
  std::vector<StageStep> steps;
  try {
    for (const StageSection& section : sections) {
      source.reach = *section.reach;
      const StagePlan chained = plan_stages(chain, source, section.frames);
      rendered.insert(chained.source.begin(), chained.source.end());
      guides.insert(chained.guides.begin(), chained.guides.end());
      if (steps.empty()) {
        steps = chained.steps;
        const SequenceDesc& small = chained.source_desc;
        if (!resize(small.width, small.height, plan.render.settings)) {
          throw Error(
              ErrorCode::kBadInput,
              fmt::format("pictures are rendered at {}x{} and made larger by stages, where the crop window lies "
                          "between pixels: its place, its size and the resolution are to be multiples of {}",
                          small.width, small.height, source.width / small.width));
        }
        for (const StageStep& step : steps) plan.stages.push_back({step.choice, "", {}, {}, between, {}, {}});
      }
      for (std::size_t i = 0; i < steps.size(); ++i) {
        const std::vector<int>& frames = chained.steps[i].frames;
        RunStage& stage = plan.stages[i];
        stage.frames.insert(stage.frames.end(), frames.begin(), frames.end());
        if (!frames.empty()) stage.sections.push_back({frames, section.sequence, section.reach});
      }
      layers = chained.steps.back().out.layers;
    }
    if (shot.halo >= 0) plan.loss = halo_loss(chain, source, sections);
  } catch (const MissingLayerError& e) {
    throw Error(e.code(), stages_loc(config, e.step()),
                fmt::format("{}, which no step before it writes: {}", e.message(), how_to_get(e.use().layer, shot)));
  } catch (const Error& e) {
    if (!e.loc().file.empty() || stages_loc(config).file.empty()) throw;
    throw Error(e.code(), stages_loc(config), e.message());
  }
  plan.stages.back().write = shot.final_write;
  plan.stages.back().leave_out = shot.stage_layers;
  std::erase_if(layers, [&](const LayerDesc& d) {
    return std::find(shot.stage_layers.begin(), shot.stage_layers.end(), d.name) != shot.stage_layers.end();
  });
  for (std::size_t i = 0; i < steps.size(); ++i) {
    if (!steps[i].fills()) continue;
    Shot pixels = pixel_shot(config, shot, steps[i]);
    pixels.frames = plan.stages[i].frames;
    pixels.write = between;
    plan.stages[i].pixels = std::move(pixels);
  }
  const std::vector<int>& made = plan.stages.back().frames;
  std::erase_if(plan.frames, [&](int f) { return !std::binary_search(made.begin(), made.end(), f); });
  if (plan.frames.empty()) {
    throw Error(ErrorCode::kBadInput, stages_loc(config),
                fmt::format("the stages make none of the frames {}", describe_frames(shot.frames)));
  }
  plan.render.frames.assign(rendered.begin(), rendered.end());
  for (const int f : plan.render.frames) {
    if (std::find(shot.frames.begin(), shot.frames.end(), f) == shot.frames.end()) plan.neighbors.push_back(f);
  }
  if (!guides.empty()) plan.guides = guide_shot(shot, guides, between);
  plan_places(config, shot, steps, plan);
  return layers;
}

/// `layers`: of the frames that are the result.
void plan_movie(const ShotConfig& config, const Shot& shot, const std::vector<LayerDesc>& layers, RunPlan& plan) {
  if (shot.video_path.empty() && plan.frames.size() < 2) return;
  fs::path movie = shot.video_path;
  if (movie.empty()) movie = default_movie(plan.render.output, shot.video.codec == "ffv1" ? ".mkv" : ".mp4");
  plan.video_path = (shot.is_part && !shot.video_path_is_typed ? with_range(movie, shot.frames) : movie).string();
  try {
    check_video(plan.video_path, shot.video);
  } catch (const Error& e) {
    const SourceLoc loc = config.loc(config.find("video.path") ? "video.path" : "video.codec");
    throw Error(ErrorCode::kBadInput, loc, e.message());
  }
  std::vector<std::string> names;
  names.reserve(layers.size());
  for (const LayerDesc& d : layers) names.push_back(d.name);
  if (std::find(names.begin(), names.end(), shot.video.layer) == names.end()) {
    throw Error(ErrorCode::kBadInput, config.loc("video.layer"),
                fmt::format("the frames will have no layer \"{}\" to show; they have {}", shot.video.layer,
                            nearest_names(shot.video.layer, names)));
  }
}

}  // namespace

RunPlan plan_run(const ShotConfig& config, const Shot& shot, bool video) {
  RunPlan plan;
  plan.render = shot;
  plan.frames = shot.frames;
  if (shot.output.empty()) {
    const std::string name = shot_name(shot.source);
    plan.render.output = (fs::path("out") / name / (name + ".####.exr")).string();
  }
  plan.output = plan.render.output;
  std::vector<LayerDesc> result = rendered_layers(shot);
  if (!shot.stages.empty()) result = plan_the_stages(config, shot, std::move(result), plan);
  check_shot_encoding(config, result, shot.final_write);
  if (video) plan_movie(config, shot, result, plan);
  return plan;
}

std::vector<FrameSequence> stage_input(const RunPlan& plan, std::size_t step) {
  const FrameSequence rendered(plan.render.output, plan.render.frames);
  const std::vector<StagePort>& ports = plan.stages[step].choice.entry->ports;
  std::vector<FrameSequence> in(ports.size(), rendered);
  for (std::size_t port = 1; port < ports.size(); ++port) {
    // Where all frames are keys there are none, and nothing reads them.
    if (ports[port].guides && plan.guides) in[port] = FrameSequence(plan.guides->output, plan.guides->frames);
  }
  if (step > 0) in[0] = FrameSequence(plan.stages[step - 1].output, plan.stages[step - 1].frames);
  if (const auto& pixels = plan.stages[step].pixels) in[1] = FrameSequence(pixels->output, pixels->frames);
  return in;
}

void run_stages(const RunPlan& plan, const Scene& scene, const RenderOptions& options, RunObserver& observer,
                const std::stop_token& stop) {
  const auto reuse = [&](const std::vector<int>& frames) {  // those that were not asked for
    RenderOptions out = options;
    out.reuse.clear();
    for (const int f : frames) {
      if (std::find(plan.frames.begin(), plan.frames.end(), f) == plan.frames.end()) out.reuse.push_back(f);
    }
    return out;
  };
  if (plan.guides) {
    const std::unique_ptr<RenderObserver> watching = observer.begin_guides(*plan.guides);
    RenderObserver* const observers[] = {watching.get()};
    observer.end_guides(*plan.guides,
                        render_sequence(*plan.guides, scene, reuse(plan.guides->frames), observers, stop));
  }
  for (std::size_t i = 0; i < plan.stages.size(); ++i) {
    const RunStage& stage = plan.stages[i];
    if (stage.pixels) {
      const std::unique_ptr<RenderObserver> watching = observer.begin_pixels(stage);
      RenderObserver* const observers[] = {watching.get()};
      observer.end_pixels(stage, render_sequence(*stage.pixels, scene, reuse(stage.frames), observers, stop));
    }
    const StageOptions of_stage{.sections = stage.sections,
                                .resume = options.resume,
                                .write = stage.write,
                                .leave_out = stage.leave_out,
                                .command = options.command};
    const std::unique_ptr<StageObserver> watching = observer.begin_stage(stage);
    observer.end_stage(stage, run_stage(stage.choice, stage_input(plan, i), stage.output, of_stage, *watching, stop));
  }
}

std::string movie_identity(const FrameSequence& frames, const VideoOptions& options) {
  std::string text = fmt::format("{};{};{};{};{};{}\n", options.fps, options.codec, options.crf, options.layer,
                                 options.display.exposure, int(options.display.tone_map));
  for (const int f : frames.frames()) text += fmt::format("{} {}\n", f, content_identity(frames.path(f)));
  return "tempera " + hash_hex(text);
}

}  // namespace tempera
