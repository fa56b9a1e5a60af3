// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/shot.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <set>

#include "hash.h"
#include "quality.h"
#include "shot_motion.h"
#include "tempera/frames/files.h"
#include "tempera/import/paths.h"
#include "tempera/pipeline/caustics.h"
#include "tempera/pipeline/materials.h"
#include "tempera/pipeline/scene_edits.h"
#include "tempera/scene/default_view.h"
#include "tempera/shading/color_space.h"

namespace tempera {

namespace {

constexpr int kMaxSide = 65536;  // pixels

/// "1280x720", "1280,720" or "0.5,1": the numbers of a list. Errors: Error{kBadInput} unless there are `count` (0:
/// any).
template <class T>
std::vector<T> numbers(const ShotConfig& config, const std::string& key, std::size_t count, const char* form) {
  const std::string& text = config.get_string(key);
  const auto fail = [&] {
    return Error(ErrorCode::kBadInput, config.loc(key),
                 fmt::format("{} = \"{}\" cannot be read; write {}", key, text, form));
  };
  std::vector<T> out;
  const char* at = text.data();
  const char* const end = text.data() + text.size();
  while (at != end) {
    while (at != end && *at == ' ') ++at;
    T v{};
    const auto [next, ec] = std::from_chars(at, end, v);
    if (ec != std::errc()) throw fail();
    out.push_back(v);
    at = next;
    while (at != end && *at == ' ') ++at;
    if (at == end) break;
    if (*at != ',' && *at != 'x') throw fail();
    if (++at == end) throw fail();
  }
  if (count > 0 && out.size() != count) throw fail();
  return out;
}

Error out_of_range(const ShotConfig& config, const std::string& key, const std::string& what) {
  return Error(ErrorCode::kOutOfRange, config.loc(key), what);
}

void settle_film(const ShotConfig& config, const Scene& scene, RenderSettings& s) {
  const RenderDefaults& defaults = scene.defaults;
  const SourceLoc scene_loc{scene.source.string()};
  s.width = defaults.width.value_or(s.width);
  s.height = defaults.height.value_or(s.height);
  const bool own_resolution = config.find("film.resolution");
  if (own_resolution) {
    const auto size = numbers<int>(config, "film.resolution", 2, "1280x720 or [1280, 720]");
    s.width = size[0], s.height = size[1];
  }
  if (std::min(s.width, s.height) < 1 || std::max(s.width, s.height) > kMaxSide) {
    throw Error(ErrorCode::kOutOfRange, own_resolution ? config.loc("film.resolution") : scene_loc,
                fmt::format("the resolution {}x{} is out of range; each side is 1 to {}", s.width, s.height, kMaxSide));
  }
  if (config.find("film.crop")) {
    const auto crop = numbers<int>(config, "film.crop", 4, "left,top,width,height");
    s.crop_x = crop[0], s.crop_y = crop[1], s.crop_width = crop[2], s.crop_height = crop[3];
  } else if (!own_resolution) {  // the scene's window is one on the scene's film
    s.crop_x = defaults.crop_x, s.crop_y = defaults.crop_y;
    s.crop_width = defaults.crop_width, s.crop_height = defaults.crop_height;
  }
  const bool whole = !config.find("film.crop") && s.crop_width == 0;
  const bool inside = s.crop_x >= 0 && s.crop_y >= 0 && s.crop_width > 0 && s.crop_height > 0 &&
                      s.crop_width <= s.width - s.crop_x && s.crop_height <= s.height - s.crop_y;
  if (!whole && !inside) {
    throw Error(ErrorCode::kOutOfRange, config.find("film.crop") ? config.loc("film.crop") : scene_loc,
                fmt::format("the crop of {}x{} at {},{} is not inside of the picture of {}x{}", s.crop_width,
                            s.crop_height, s.crop_x, s.crop_y, s.width, s.height));
  }
  const double percent = config.get_double("film.scale");
  if (percent != 100) {
    // Truncated, as Blender does; the small number keeps 33.3 % of 1000 at 333 whatever binary fractions make of it.
    const auto scaled = [&](int v) { return int(std::floor(v * percent / 100 + 1e-6)); };
    if (std::max(s.width, s.height) * percent / 100 > kMaxSide) {
      throw out_of_range(config, "film.scale", fmt::format("the scaled resolution exceeds {} pixels", kMaxSide));
    }
    s.width = std::max(scaled(s.width), 1), s.height = std::max(scaled(s.height), 1);
    if (s.crop_width > 0) {  // by its edges, so that windows that share one still do
      const auto side = [&](int& from, int& length, int size) {
        const int end = scaled(from + length);
        from = std::min(scaled(from), size - 1);
        length = std::clamp(end - from, 1, size - from);
      };
      side(s.crop_x, s.crop_width, s.width);
      side(s.crop_y, s.crop_height, s.height);
    }
  }

  // A filter that is named without a radius gets its usual one, not the scene's.
  const bool named = config.find("film.filter");
  const std::string filter = named ? config.get_string("film.filter") : defaults.filter.value_or("box");
  double radius = named ? 0 : defaults.filter_radius.value_or(0);
  if (config.find("film.filter_radius")) radius = config.get_double("film.filter_radius");
  s.filter = PixelFilter(parse_filter(filter, config.loc("film.filter")), float(radius));
}

void settle_clock(const ShotConfig& config, const RenderDefaults& defaults, FrameClock& clock) {
  clock.fps = config.get_double("fps");
  clock.first = config.get_int("first_frame");
  clock.start = config.get_double("start");
  if (defaults.shutter) clock.shutter = *defaults.shutter;
  if (defaults.exposure) {
    // The scene file gives absolute times: they are those of the first frame.
    if (!config.find("start")) clock.start = defaults.exposure->begin;
    clock.shutter.open = 0;
    clock.shutter.close = defaults.exposure->length() * clock.fps;
  }
  Shutter& shutter = clock.shutter;
  if (config.find("shutter.open")) shutter.open = config.get_double("shutter.open");
  if (config.find("shutter.close")) shutter.close = config.get_double("shutter.close");
  if (shutter.close < shutter.open) {
    throw out_of_range(config, config.find("shutter.close") ? "shutter.close" : "shutter.open",
                       fmt::format("the shutter closes at {}, before it opens at {}", shutter.close, shutter.open));
  }
  if (config.find("shutter.shape")) {
    const std::string& shape = config.get_string("shutter.shape");
    shutter.shape = shape == "box"         ? ShutterShape::kBox
                    : shape == "trapezoid" ? ShutterShape::kTrapezoid
                                           : ShutterShape::kCurve;
  }
  if (config.find("shutter.ramp_in")) shutter.ramp_in = config.get_double("shutter.ramp_in");
  if (config.find("shutter.ramp_out")) shutter.ramp_out = config.get_double("shutter.ramp_out");
  if (shutter.ramp_in + shutter.ramp_out > 1) {
    throw out_of_range(config, config.find("shutter.ramp_out") ? "shutter.ramp_out" : "shutter.ramp_in",
                       "shutter.ramp_in and shutter.ramp_out add up to more than 1");
  }
  if (config.find("shutter.curve"))
    shutter.curve = numbers<float>(config, "shutter.curve", 0, "numbers, e.g. [0, 1, 1, 0]");
  if (shutter.shape == ShutterShape::kCurve) {
    const auto& curve = shutter.curve;
    if (curve.size() < 2 || std::any_of(curve.begin(), curve.end(), [](float v) { return !(v >= 0) || v > 1e30f; }) ||
        std::all_of(curve.begin(), curve.end(), [](float v) { return v == 0; })) {
      throw out_of_range(config, config.find("shutter.curve") ? "shutter.curve" : "shutter.shape",
                         "a shutter curve needs at least two numbers from 0 up, not all of them 0");
    }
  }
  if (config.find("shutter.rolling")) shutter.rolling = config.get_double("shutter.rolling");
}

int find_camera(const ShotConfig& config, const Scene& scene) {
  const char* key = config.find("camera") ? "camera" : "camera.name";
  if (!config.find(key)) return scene.default_camera;
  const std::string& wanted = config.get_string(key);
  std::vector<std::string> names;
  for (int i = 0; i < std::ssize(scene.cameras); ++i) {
    if (scene.cameras[i].name == wanted) return i;
    names.push_back(fmt::format("{} ({})", i, scene.cameras[i].name));
  }
  int index = -1;
  const auto [end, ec] = std::from_chars(wanted.data(), wanted.data() + wanted.size(), index);
  if (ec == std::errc() && end == wanted.data() + wanted.size() && index >= 0 && index < std::ssize(scene.cameras)) {
    return index;
  }
  throw Error(ErrorCode::kUnknownName, config.loc(key),
              fmt::format("the scene has no camera \"{}\"; it has: {}", wanted, nearest_names(wanted, names)));
}

std::vector<int> parse_frames(const ShotValue& value) {
  try {
    return parse_frame_set(std::get<std::string>(value.value));
  } catch (const Error& e) {
    throw Error(value.loc.line > 0 ? ErrorCode::kBadInput : ErrorCode::kUsage, value.loc, e.message());
  }
}

/// Frames that the scene's animation covers; none if the scene does not say. Errors: Error{kOutOfRange} for too many.
std::vector<int> animated_frames(const Scene& scene, const FrameClock& clock) {
  // Absolute shutter times mean one picture.
  if (!(scene.animation.length() > 0) || scene.defaults.exposure) return {};
  // Keys are rarely at exact multiples of the frame's duration; a thousandth of a frame decides for "on it".
  const auto frame = [&](double t) { return (t - clock.start) * clock.fps + clock.first; };
  const double first = std::ceil(frame(scene.animation.begin) - 1e-3),
               last = std::floor(frame(scene.animation.end) + 1e-3);
  constexpr double kMaxFrames = 1e6;
  if (!(last - first < kMaxFrames) || std::abs(first) > 1e9) {
    throw Error(ErrorCode::kOutOfRange, {scene.source.string()},
                fmt::format("the animation from {} to {} s has more than {} frames; name those to render (--frames)",
                            scene.animation.begin, scene.animation.end, kMaxFrames));
  }
  std::vector<int> frames{int(first)};  // one at least
  for (double f = first + 1; f <= last; ++f) frames.push_back(int(f));
  return frames;
}

void settle_frames(const ShotConfig& config, const Scene& scene, Shot& shot) {
  const FrameClock& clock = shot.settings.clock;
  const ShotValue *asked = config.find("frames"), *written = config.find_in_file("frames");
  std::vector<int> whole;
  if (written) {
    whole = parse_frames(*written);
  } else {
    try {
      whole = animated_frames(scene, clock);
    } catch (const Error&) {
      if (!asked) throw;  // else the frames that were asked for are all that is known of the sequence
    }
  }
  shot.frames = asked ? parse_frames(*asked) : whole;
  if (shot.frames.empty()) shot.frames = {clock.first};
  if (whole.empty()) whole = shot.frames;
  const auto [first, last] = std::minmax_element(whole.begin(), whole.end());
  shot.sequence = {*first, *last};
  const std::set<int> chosen(shot.frames.begin(), shot.frames.end());
  shot.is_part = std::any_of(whole.begin(), whole.end(), [&](int f) { return !chosen.contains(f); });
}

/// Frames for which motion blur can be added.
constexpr double kLongestShutter = 2;

/// The parameters of a stage, from its table. Errors: where one is given that is at fault.
Params stage_params(const ShotConfig& config, const StageEntry& entry, const Shot& shot) {
  Params params(entry.params);
  const auto key = [&](const std::string& param) { return entry.name + "." + param; };
  const Shutter& shutter = shot.settings.clock.shutter;
  if (entry.takes_cuts) params.set("cuts", fmt::format("{}", fmt::join(shot.settings.cuts, ",")));
  // A shutter that is closed stays so for a quality; a shot that names the stage wants it opened.
  const bool opens = shutter.close > shutter.open || (quality_of(config) && !config.find("stages"));
  if (entry.opens_shutter && opens && shutter.close - shutter.open <= kLongestShutter)
    params.set("shutter", shutter.close - shutter.open);
  for (const ParamSpec& s : entry.params) {
    if (const ShotValue* v = config.find(key(s.name))) params.set(s.name, v->value, v->loc);
  }
  if (entry.name == kDenoiser && quality_of(config) && !config.find(key("method"))) params.set("method", "auto");
  try {
    entry.make(params);
  } catch (const StageParamError& e) {  // of several together
    const auto given = std::find_if(e.params().begin(), e.params().end(),
                                    [&](const std::string& param) { return config.find(key(param)) != nullptr; });
    throw Error(e.code(), given == e.params().end() ? SourceLoc{} : config.loc(key(*given)), e.message());
  }
  return params;
}

/// `layers`: of the rendered frames.
void settle_stages(const ShotConfig& config, std::span<const LayerDesc> layers, Shot& shot) {
  std::map<std::string, Params> params;  // tables of stages that the shot leaves out are checked, too
  for (const StageEntry* e : stage_catalog()) params[e->name] = stage_params(config, *e, shot);
  const auto add = [&](const StageEntry& e) {
    shot.stages.push_back({{&e, params.at(e.name)}, config.get_string(e.name + ".path")});
  };
  shot.halo = config.get_int("halo");
  if (!config.find("stages")) {
    for (const StageEntry* e : stage_catalog()) {
      if (e->follows && e->follows(layers)) add(*e);
    }
    if (const Quality* quality = quality_of(config)) {
      for (const std::string& name : quality->stages) add(find_stage(name));
    }
    return;
  }
  std::string_view text = config.get_string("stages");
  for (std::size_t i = 0; !text.empty(); ++i) {
    std::string_view name = text.substr(0, text.find(','));
    text.remove_prefix(std::min(name.size() + 1, text.size()));
    while (!name.empty() && name.front() == ' ') name.remove_prefix(1);
    while (!name.empty() && name.back() == ' ') name.remove_suffix(1);
    const SourceLoc loc = config.loc("stages", i);
    const StageEntry& entry = find_stage(std::string(name), loc);
    if (!entry.inserted_help.empty()) {
      throw Error(ErrorCode::kBadInput, loc, fmt::format("{} is not named: it {}", name, entry.inserted_help));
    }
    for (const ShotStage& s : shot.stages) {
      if (s.choice.entry == &entry)
        throw Error(ErrorCode::kBadInput, loc, fmt::format("the stage {} is named twice", name));
    }
    add(entry);
  }
}

/// What stages need of each other, and of how frames are rendered for them. Errors: Error{kUnsupported | kBadInput} where
/// the shot asks for what they cannot do.
void settle_stage_needs(const ShotConfig& config, Shot& shot) {
  // Frames around a key are not rendered at all: it is denoised alone. And each class of light by itself, as classes are
  // what is followed to the next key.
  bool keys = false;
  for (std::size_t i = shot.stages.size(); i-- > 0;) {
    StageChoice& choice = shot.stages[i].choice;
    if (keys && choice.entry->name == kDenoiser) {
      if (!config.find("denoise.radius")) choice.params.set("radius", 0);
      const std::string& method = choice.params.get_string("method");
      const bool takes_recipes = method != "published" && method != "rmz13";
      if (shot.settings.classes_are_decomposition && takes_recipes && !config.find("denoise.recipe"))
        choice.params.set("recipe", "classes");
    }
    keys |= choice.entry->takes_keys;
  }
  Shutter& shutter = shot.settings.clock.shutter;
  const StageEntry *sharp = nullptr, *opens = nullptr;
  for (const ShotStage& s : shot.stages) {
    if (s.choice.entry->sharp) sharp = s.choice.entry;
    if (s.choice.entry->opens_shutter) opens = s.choice.entry;
  }
  if (keys && !shot.settings.seed_per_frame) {
    throw Error(ErrorCode::kBadInput, config.loc("sampling.seed_per_frame"),
                "seed_per_frame = false gives all frames the same noise, which frames in between would take for light");
  }
  if (!sharp || shutter.close == shutter.open) return;
  const auto where = [&](const char* key) { return config.find(key) ? config.loc(key) : stages_loc(config); };
  if (!opens) {
    throw Error(ErrorCode::kBadInput, where("shutter.close"),
                fmt::format("the stage {} needs sharp frames: close the shutter (shutter.close = {}), or add the stage "
                            "motionblur, which opens it again",
                            sharp->name, shutter.open));
  }
  if (shutter.shape != ShutterShape::kBox || shutter.rolling != 0) {
    throw Error(ErrorCode::kUnsupported, where(shutter.rolling != 0 ? "shutter.rolling" : "shutter.shape"),
                fmt::format("the stage {} opens the shutter for all lines at once, and fully: it knows no shape or "
                            "rolling shutter",
                            opens->name));
  }
  if (shutter.close - shutter.open > kLongestShutter) {
    throw Error(ErrorCode::kUnsupported, where("shutter.close"),
                fmt::format("the stage {} opens the shutter for {} frames at most, not for {}", opens->name,
                            kLongestShutter, shutter.close - shutter.open));
  }
  shutter.open = shutter.close = (shutter.open + shutter.close) / 2;
}

/// Asks the integrator for what a stage that the shot names can make use of, as far as it writes that.
void add_layers_for(const StageChoice& stage, Shot& shot, std::vector<LayerDesc>& layers) {
  const RenderSettings& s = shot.settings;
  SequenceDesc rendered{shot.sequence, shot.sequence, {}, s.x1() - s.x0(), s.y1() - s.y0(), layers};
  std::set<std::string> tried;
  const auto next = [&]() -> std::optional<LayerDesc> {  // what it can use may depend on what there is
    const std::vector<SequenceDesc> in(stage.entry->ports.size(), rendered);
    for (int port = 0; port < std::ssize(in); ++port) {
      for (const LayerUse& use : stage.entry->make(stage.params)->reads(port, in)) {
        if (!rendered.has(use.layer) && tried.insert(use.layer.name).second) return use.layer;
      }
    }
    return std::nullopt;
  };
  const auto ask = [&](const LayerDesc& layer) {
    RenderSettings more = shot.settings;
    more.layers.push_back(layer.name);
    try {
      rendered.layers = rendered_layers(shot.integrator, shot.params, more);
      shot.settings = std::move(more);
    } catch (const SettingError&) {  // the stage says what it misses
    }
  };
  try {
    // Not of few samples, of which what mirrors and glass show is mostly noise.
    if (stage.entry->name == kDenoiser && s.spp > kFewSamples) {
      SequenceDesc with = rendered;
      const std::array<LayerDesc, 2> seen{layers::chain_layer(layers::kAnyChain, layers::albedo()),
                                          layers::chain_layer(layers::kAnyChain, layers::normal())};
      with.layers.insert(with.layers.end(), seen.begin(), seen.end());
      const std::vector<LayerUse> uses = stage.entry->make(stage.params)->reads(0, std::span(&with, 1));
      for (const LayerDesc& d : seen) {
        if (std::any_of(uses.begin(), uses.end(), [&](const LayerUse& use) { return use.layer == d; })) ask(d);
      }
    }
    while (const auto layer = next()) ask(*layer);
  } catch (const Error&) {
    return;  // who plans the stages says it, and where
  }
  for (const LayerDesc& d : rendered.layers) {
    if (std::find(layers.begin(), layers.end(), d) == layers.end()) shot.stage_layers.push_back(d.name);
  }
  layers = rendered.layers;
}

void settle_classes(const ShotConfig& config, RenderSettings& s) {
  auto classes = config.table("classes"), parts = config.table("decompose");
  if (const auto tree = parts.find({"tree"}); tree != parts.end() && tree->second.is_text) {
    // Asked for on the command line: instead of what the shot says.
    std::erase_if(parts, [](const auto& part) { return !part.second.is_text; });
    classes.clear();
  }
  if (!classes.empty() && !parts.empty()) {
    throw Error(ErrorCode::kBadInput, parts.begin()->second.loc,
                "classes and decompose cannot be given together; a class may be a part of the decomposition");
  }
  s.classes_are_decomposition = !parts.empty();
  std::vector<std::string> expressions;
  std::vector<SourceLoc> locs;
  for (const auto& [key, value] : s.classes_are_decomposition ? parts : classes) {
    if (s.classes_are_decomposition && key[0] == "tree") {
      if (to_text(value.value) != "default") {
        throw Error(ErrorCode::kUnknownName, value.loc,
                    fmt::format("unknown decomposition \"{}\"; known: default", to_text(value.value)));
      }
      for (const PathClass& c : default_decomposition()) {
        s.classes.push_back(c);
        expressions.push_back(c.expression), locs.push_back(value.loc);
      }
      continue;
    }
    if (expressions.size() == LightPathClassifier::kMaxExpressions) {
      throw Error(ErrorCode::kOutOfRange, value.loc,
                  fmt::format("there can be at most {} light-path classes", LightPathClassifier::kMaxExpressions));
    }
    const std::string& name = key[0];
    const bool plain =
        std::all_of(name.begin(), name.end(), [](unsigned char c) { return std::isalnum(c) || c == '_' || c == '-'; });
    if (!plain || name == "residual") {
      throw Error(
          ErrorCode::kBadInput, value.loc,
          fmt::format("\"{}\" cannot name a class; use letters, digits, '_' and '-', and not \"residual\"", name));
    }
    SourceLoc loc = value.loc;
    if (loc.column > 0) ++loc.column;  // past the opening quote
    const std::string expression = to_text(value.value);
    LightPathClassifier(std::vector{expression}, loc);
    s.classes.push_back({name, expression});
    expressions.push_back(expression);
    locs.push_back(value.loc);
  }
  const LightPathClassifier classifier(expressions, locs.empty() ? SourceLoc{} : locs[0]);
  if (!s.classes_are_decomposition) return;
  if (const auto overlap = classifier.overlap()) {
    throw Error(
        ErrorCode::kBadInput, locs[overlap->second],
        fmt::format("the classes \"{}\" and \"{}\" overlap: both hold the path {}; parts of a decomposition must not",
                    s.classes[overlap->first].name, s.classes[overlap->second].name, overlap->witness));
  }
}

/// The value under its own type if it is TOML, converted if it is text of the command line.
void set_param(Params& params, const std::string& name, const ShotValue& value) {
  if (!value.is_text) {
    params.set(name, value.value, value.loc);
  } else {
    params.set_text(name, to_text(value.value), value.loc);
  }
}

void settle_integrator(const ShotConfig& config, const RenderDefaults& defaults, Shot& shot) {
  shot.integrator =
      config.find("integrator.name") ? config.get_string("integrator.name") : defaults.integrator.value_or("path");
  const MethodEntry& entry = find_method(shot.integrator, config.loc("integrator.name"));
  shot.params = Params(entry.params);
  const auto takes = [&](const char* name) {
    return std::any_of(entry.params.begin(), entry.params.end(), [&](const ParamSpec& s) { return s.name == name; });
  };
  if (defaults.max_depth && takes("max_depth")) shot.params.set("max_depth", *defaults.max_depth);
  if (defaults.rr_depth && takes("rr_depth")) shot.params.set("rr_depth", *defaults.rr_depth);
  if (defaults.hide_emitters && takes("hide_emitters")) shot.params.set("hide_emitters", *defaults.hide_emitters);
  if (takes("null_counts_as_bounce")) shot.params.set("null_counts_as_bounce", defaults.null_counts_as_bounce);
  // The table in the file was written for the integrator that the file names. Where the command line chooses another,
  // what that one does not have is not an error of the file.
  const bool chosen_outside = config.find("integrator.name") && config.loc("integrator.name").line == 0;
  std::vector<std::string> left_out;
  for (const auto& [key, value] : config.table("integrator")) {
    if (chosen_outside && value.loc.line > 0 && !takes(key[0].c_str())) {
      left_out.push_back(key[0]);
    } else {
      set_param(shot.params, key[0], value);
    }
  }
  if (!left_out.empty()) {
    log_warning(
        fmt::format("the integrator \"{}\" has no parameter {}: ignored", shot.integrator, fmt::join(left_out, ", ")));
  }
}

void replace_environment(const ShotConfig& config, Shot& shot, Scene& scene) {
  const bool wanted = std::any_of(shot_keys().begin(), shot_keys().end(), [&](const ShotKey& k) {
    return k.spec.name.starts_with("environment.") && config.find(k.spec.name);
  });
  if (!wanted) return;
  Environment env;
  env.name = "shot";
  env.camera_visible = config.get_bool("environment.camera_visible");
  shot.edits += fmt::format("environment:visible={}", env.camera_visible);
  if (config.find("environment.radiance")) {
    const auto c = parse_color(config.get_string("environment.radiance"));
    if (!c || std::min({c->r, c->g, c->b}) < 0) {
      throw Error(ErrorCode::kBadInput, config.loc("environment.radiance"),
                  fmt::format("environment.radiance = \"{}\" cannot be read; write one number or three, none below 0",
                              config.get_string("environment.radiance")));
    }
    env.radiance = *c;
    shot.edits += fmt::format(",radiance={},{},{}", c->r, c->g, c->b);
  }
  if (config.find("environment.image")) {
    const std::string path = config.input_path("environment.image").string();
    try {
      ReadOptions stored;
      stored.decode = false;
      const Frame frame = read_frame(path, stored);
      const Image& image = frame.layer("color");
      const std::string& id = config.get_string("environment.color_space");
      const std::optional<ColorSpace> space = id.empty() ? file_color_space(path) : named_color_space(id);
      if (!space) {
        throw Error(ErrorCode::kUnknownName, config.loc("environment.color_space"),
                    fmt::format("the color space \"{}\" is not known; write for example lin_rec709_scene, "
                                "srgb_rec709_scene, lin_ap1_scene or data",
                                id));
      }
      shot.edits += fmt::format(",space={}", id);
      env.width = image.width(), env.height = image.height();
      env.image.reserve(image.pixels());
      bool repaired = false;
      for (int y = 0; y < env.height; ++y) {
        for (int x = 0; x < env.width; ++x) {
          const Rgb c = space->to_linear(image.rgb(x, y));
          // Overexposed or damaged pixels of captured maps; one would poison every sample of the light.
          const auto safe = [&](float v) {
            if (std::isfinite(v) && v >= 0) return v;
            repaired = true;
            return 0.0f;
          };
          env.image.push_back({safe(c.r), safe(c.g), safe(c.b)});
        }
      }
      if (repaired) {
        log_warning(fmt::format(
            "{}: pixels of an environment image that are negative, infinite or not a number are set to 0", path));
      }
      shot.edits += fmt::format(",image={:016x}", hash_bytes(read_file(path)));
    } catch (const Error& e) {
      if (e.loc().line > 0 || e.loc().file == ShotConfig::kCommandLine().file) throw;
      throw Error(e.code(), config.loc("environment.image"), e.what());
    }
  }
  const auto degrees = numbers<double>(config, "environment.rotation", 0, "an angle, or three around x, y and z");
  const bool finite = std::all_of(degrees.begin(), degrees.end(), [](double d) { return std::abs(d) < 1e9; });
  if ((degrees.size() != 1 && degrees.size() != 3) || !finite) {
    throw Error(ErrorCode::kBadInput, config.loc("environment.rotation"),
                fmt::format("environment.rotation = \"{}\" cannot be read; write one angle, or three around x, y and z",
                            config.get_string("environment.rotation")));
  }
  const auto turn = [](const Vec3d& axis, double angle) {
    return Affine3d(rotation(axis_angle(axis, angle * kPiD / 180)));
  };
  const Vec3d x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1};
  Affine3d world_from_picture = turn(y, degrees[0]);
  if (degrees.size() == 3) {
    // Blender turns directions by its mapping before it looks into the picture, in whose middle is x and on top z.
    constexpr Affine3d kFromBlender{{1, 0, 0}, {0, 0, -1}, {0, 1, 0}};
    const Affine3d mapping = turn(z, degrees[2]) * turn(y, degrees[1]) * turn(x, degrees[0]);
    world_from_picture = kFromBlender * inverse(mapping) * inverse(kFromBlender) * turn(y, 90);
  }
  if (degrees.size() == 3 || degrees[0] != 0) {
    Node node;
    node.name = "shot environment";
    node.local = AnimatedTransform(world_from_picture);
    env.node = int(scene.nodes.size());
    scene.nodes.push_back(std::move(node));
    shot.edits += fmt::format(",rotation={}", fmt::join(degrees, ","));
  }
  const bool keep = config.get_bool("environment.keep");
  shot.edits += keep ? ",keep;" : ";";
  if (!keep) scene.environments.clear();
  scene.environments.push_back(std::move(env));
}

void replace_materials(const ShotConfig& config, Shot& shot, Scene& scene) {
  struct Override {
    std::map<std::string, ParamValue> values;
    std::map<std::string, SourceLoc> locs;
  };
  std::map<std::string, Override> overrides;
  for (const auto& [key, value] : config.table("materials")) {
    Override& o = overrides[key[0]];
    o.values[key[1]] = value.value;
    o.locs[key[1]] = value.loc;
    shot.edits += fmt::format("material:{}.{}={};", key[0], key[1], to_text(value.value));
  }
  const auto files = [&](const std::string& name, const SourceLoc& loc) {
    const std::filesystem::path file = config.input_path({name, loc});
    if (std::error_code ignored; std::filesystem::is_regular_file(file, ignored)) {
      shot.edits += fmt::format("file:{:016x};", hash_bytes(read_file(file.string())));
    }
    return file;
  };
  for (const auto& [name, o] : overrides) override_material(scene, name, o.values, o.locs, files);
}

}  // namespace

ShotConfig read_shot_config(const std::filesystem::path& file) {
  ShotConfig config;
  if (file.extension() == ".toml") {
    config.read_file(file);
    return config;
  }
  std::vector<std::string> extensions{".toml"};
  for (const ImporterEntry* i : importers())
    extensions.insert(extensions.end(), i->extensions.begin(), i->extensions.end());
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  if (std::find(extensions.begin(), extensions.end(), extension) == extensions.end()) {
    std::error_code ignored;
    if (!std::filesystem::exists(file, ignored)) {
      throw Error(ErrorCode::kMissingFile, {file.string()}, "no such file");
    }
    throw Error(ErrorCode::kUnsupported, {file.string()},
                fmt::format("\"{}\" files are not scenes; known: {}", extension, fmt::join(extensions, ", ")));
  }
  config.set_text("scene", file.string(), ShotConfig::kCommandLine());
  return config;
}

Scene import_shot_scene(const ShotConfig& config, const ImportOptions& options, Warnings& warnings) {
  if (!config.find("scene")) {
    throw Error(ErrorCode::kBadInput, {config.file().string()}, "the shot names no scene; add scene = \"FILE\"");
  }
  ImportOptions import = options;
  import.fps = config.get_double("fps");
  import.animation = config.get_string("animation");
  import.tints_once = config.get_string("solid_tint") == "once";
  for (const auto& [key, value] : config.table("define")) import.defines.emplace_back(key[0], to_text(value.value));
  const std::filesystem::path file = config.input_path("scene");
  if (std::error_code ignored; !std::filesystem::exists(file, ignored)) {
    // At the key that names it, if a file did.
    const SourceLoc loc = config.loc("scene").line > 0 ? config.loc("scene") : SourceLoc{file.string()};
    throw Error(ErrorCode::kMissingFile, loc, cannot_find(file));
  }
  return import_scene(file, import, warnings);
}

namespace {

void settle_motion(const ShotConfig& config, Scene& scene, Shot& shot) {
  RenderSettings& s = shot.settings;
  std::vector<int> cuts;
  if (config.find("cuts")) cuts = numbers<int>(config, "cuts", 0, "frame numbers, e.g. [8, 120]");
  if (!cuts.empty()) {
    cut_motion(scene, s.clock, cuts);
    shot.edits += fmt::format("cuts:{}", fmt::join(cuts, ","));
  }
  s.cuts = find_cuts(scene, s, cuts);
  std::optional<int> segments;
  if (const std::string& text = config.get_string("motion_segments"); text != "auto") {
    segments = numbers<int>(config, "motion_segments", 1, "auto, or a whole number from 1 to 1024")[0];
    if (*segments < 1 || *segments > 1024) {
      throw out_of_range(config, "motion_segments",
                         fmt::format("motion_segments = {} is not within 1 to 1024", *segments));
    }
  }
  shot.motion_segments = settle_motion_segments(scene, s, segments);
}

/// Leaves caustics to photons for a quality that is made of few samples, where the shot does not say who finds them and
/// they can be seen.
void choose_caustics(const ShotConfig& config, const Scene& scene, Shot& shot) {
  const Quality* quality = quality_of(config);
  const std::span<const ParamSpec> specs = shot.params.specs();
  const bool chooses = std::any_of(specs.begin(), specs.end(), [](const ParamSpec& s) { return s.name == "caustics"; });
  if (!quality || !quality->chooses_caustics || !chooses || config.find("integrator.caustics")) return;
  const double coverage = caustics_coverage(scene, shot);
  if (coverage < kCausticsMatter) return;
  shot.params.set_text("caustics", "photons");
  log_info(
      fmt::format("quality \"{}\": caustics are seen in {:.2g} % of the picture and left to photons "
                  "(integrator.caustics = \"paths\" leaves them to paths)",
                  quality->name, 100 * coverage));
}

}  // namespace

Shot settle_shot(const ShotConfig& config, Scene& scene) {
  Shot shot;
  shot.scene_file = config.input_path("scene");
  shot.source = config.file().empty() ? shot.scene_file : config.file();
  if (scene.cameras.empty()) {
    add_default_camera(scene);
    log_warning(fmt::format("{} has no camera: using one that sees everything", scene.source.string()));
  }
  RenderSettings& s = shot.settings;
  settle_film(config, scene, s);
  settle_clock(config, scene.defaults, s.clock);
  s.camera = find_camera(config, scene);
  shot.edits += edit_cameras(config, s, scene);
  shot.edits += attach_caches(config, s.clock, scene);
  const Quality* quality = quality_of(config);
  s.spp = config.find("sampling.spp") ? config.get_int("sampling.spp")
          : quality                   ? quality->spp
                                      : scene.defaults.spp.value_or(s.spp);
  s.seed = std::uint64_t(config.get_int("sampling.seed"));
  s.seed_per_frame = config.get_bool("sampling.seed_per_frame");
  const std::string sampler = config.find("sampling.sampler") ? config.get_string("sampling.sampler")
                                                              : scene.defaults.sampler.value_or("sobol");
  s.sampler = sampler == "independent" ? SamplerKind::kIndependent : SamplerKind::kSobol;
  s.layers.clear();
  for (const LayerDesc& d : parse_layer_names(config.get_string("output.layers"), config.loc("output.layers"))) {
    s.layers.push_back(d.name);
  }
  if (std::find(s.layers.begin(), s.layers.end(), "color") == s.layers.end())
    s.layers.insert(s.layers.begin(), "color");
  s.cryptomatte_depth = config.get_int("output.cryptomatte_depth");
  settle_classes(config, s);
  settle_integrator(config, scene.defaults, shot);

  settle_frames(config, scene, shot);
  if (config.find("output.path"))
    shot.output = settle_output(config, shot, "output.path", shot_name(shot.source) + ".####.exr");
  shot.write.compression = parse_compression(config.get_string("output.compression"));
  shot.write.half = config.get_bool("output.half");
  shot.write.names = parse_aov_names(config.get_string("output.aov_names"));
  shot.write.view_layer = config.get_string("output.view_layer");
  if (shot.write.view_layer.empty() || shot.write.view_layer.find('.') != std::string::npos) {
    throw Error(
        ErrorCode::kBadInput, config.loc("output.view_layer"),
        fmt::format("\"{}\" cannot name a view layer: it must hold something, and no dot", shot.write.view_layer));
  }
  shot.final_write = shot.write;
  // Deflating what the denoiser reads takes longer than a sample.
  if (quality && s.spp <= kFewSamples && !config.find("output.compression")) shot.write.compression = Compression::kRle;
  shot.video_path = config.get_string("video.path");
  shot.video_path_is_typed = config.find("video.path") && config.loc("video.path").line == 0;
  shot.video.fps = config.get_double("video.fps") > 0 ? config.get_double("video.fps") : s.clock.fps;
  shot.video.codec = config.get_string("video.codec");
  shot.video.crf = config.get_int("video.crf");
  shot.video.layer = config.get_string("video.layer");
  shot.video.display.exposure = float(config.get_double("video.exposure"));
  shot.video.display.tone_map = parse_tone_map(config.get_string("video.tone_map"));
  if (config.find("bend_normals")) {
    scene.bend_normals = config.get_bool("bend_normals");
    shot.edits += fmt::format("bend_normals={};", scene.bend_normals);
  }
  if (config.find("solid_tint")) shot.edits += fmt::format("solid_tint={};", config.get_string("solid_tint"));
  replace_environment(config, shot, scene);
  replace_materials(config, shot, scene);
  shot.edits += edit_lights(config, s.clock, scene);
  if (!has_light(scene)) {
    add_default_light(scene);
    log_warning(
        fmt::format("{} has no light: adding a dim environment and a directional light", scene.source.string()));
  }

  settle_motion(config, scene, shot);
  choose_caustics(config, scene, shot);

  // Which layers an integrator can write is its own knowledge; ask it before a ray is traced.
  std::vector<LayerDesc> layers;
  try {
    layers = rendered_layers(shot);
    const auto method = find_method(shot.integrator).make(shot.params);
    const int frame = shot.frames.empty() ? shot.sequence.first : shot.frames[0];
    method->passes(s, method->section(s, shot.sequence, frame));
    if (config.find("film.mask")) {
      shot.mask = config.input_path("film.mask").string();
      if (!method->renders_single_pixels()) {
        throw SettingError(ErrorCode::kUnsupported, "film.mask",
                           fmt::format("the integrator \"{}\" with these parameters renders whole pictures alone: it "
                                       "takes no mask",
                                       shot.integrator));
      }
    }
  } catch (const SettingError& e) {
    // Where the scene or a default made the setting, the choice of the integrator is at fault.
    throw Error(e.code(), config.loc(config.find(e.key()) ? e.key() : "integrator.name"), e.message());
  }
  settle_stages(config, layers, shot);
  shot.guide_spp = config.get_int("guides.spp");
  settle_stage_needs(config, shot);
  if (config.find("stages") || quality) {
    for (const ShotStage& stage : shot.stages) add_layers_for(stage.choice, shot, layers);
  }
  const bool exact = std::any_of(layers.begin(), layers.end(),
                                 [](const LayerDesc& d) { return d.role == LayerRole::kReconstruction; });
  if (shot.write.half && exact) {
    log_warning("differences of 16-bit floats are too coarse to reconstruct from: rendered files hold 32-bit floats");
    shot.write.half = false;
  }
  return shot;
}

std::vector<LayerDesc> rendered_layers(const std::string& integrator, const Params& params,
                                       const RenderSettings& settings) {
  return find_method(integrator).make(params)->outputs(settings);
}

std::string shot_name(const std::filesystem::path& source) {
  const std::string stem = source.stem().string();
  const std::string folder = std::filesystem::absolute(source).parent_path().filename().string();
  const bool generic = stem == "shot" || stem.starts_with("shot_");
  return generic && !folder.empty() ? folder + stem.substr(4) : stem;
}

std::string settle_output(const ShotConfig& config, const Shot& shot, const std::string& key, const std::string& name) {
  const SourceLoc loc = config.loc(key);
  const bool single = shot.frames.size() == 1 && (!shot.is_part || loc.line == 0);
  try {
    return output_pattern(config.get_string(key), name, single);
  } catch (const Error& e) {
    throw Error(loc.line > 0 ? ErrorCode::kBadInput : ErrorCode::kUsage, loc, e.message());
  }
}

void check_shot_encoding(const ShotConfig& config, const std::vector<LayerDesc>& layers, const WriteOptions& options) {
  try {
    check_encoding(layers, options);
  } catch (const Error& e) {
    throw Error(e.code(), config.loc(config.find("output.compression") ? "output.compression" : "output.aov_names"),
                e.message());
  }
}

LoadedShot load_shot(const ShotConfig& config, const ImportOptions& options, Warnings& warnings) {
  LoadedShot loaded;
  loaded.scene = import_shot_scene(config, options, warnings);
  loaded.shot = settle_shot(config, loaded.scene);
  return loaded;
}

std::string fingerprint(const Shot& shot, const Scene& scene, int frame) {
  const WriteOptions& w = shot.write;
  // What a section has in common, and a mask, where there are such.
  std::string more;
  const FrameRange section =
      find_method(shot.integrator).make(shot.params)->section(shot.settings, shot.sequence, frame);
  if (section.first != section.last) more += fmt::format(";section={}-{}", section.first, section.last);
  if (!shot.mask.empty()) more += ";mask=" + content_identity(frame_path(shot.mask, frame));
  return hash_hex(fmt::format("{};{:016x};{};{};{}:{};motion={};frame={};half={};names={};lossy={}{}", TEMPERA_VERSION,
                              scene.content_hash, shot.edits, shot.settings.canonical(), shot.integrator,
                              shot.params.canonical(), shot.motion_segments, frame, w.half, names_text(w),
                              w.compression == Compression::kDwaa, more));
}

}  // namespace tempera
