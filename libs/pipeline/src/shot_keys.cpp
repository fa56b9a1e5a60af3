// SPDX-License-Identifier: Apache-2.0
// The keys of shot.toml. What stands here is what --help, docs/shot.md and the parser know.
#include <fmt/format.h>

#include <algorithm>

#include "tempera/pipeline/scene_edits.h"
#include "tempera/pipeline/shot_config.h"
#include "tempera/stages/stage.h"

namespace tempera {

namespace {
constexpr double kMany = 1e300;

/// The keys in the order of the manual, but for those of stages.
std::vector<ShotKey> own_keys() {
  return {
      // clang-format off
      {{"scene", "", "scene file: Mitsuba XML or glTF; relative to shot.toml"}, "", "FILE", "the file given"},
      {{"camera", "", "camera, by name or by index from 0"}, "--camera", "NAME", "the scene's first or active one"},
      {{"animation", "", "glTF: the one animation to play"}, "--animation", "NAME", "all of them together"},
      {{"bend_normals", true, "shading normals that the viewer cannot see, or that mirror the view into the surface, are bent back, and shadows soften where coarse meshes end the light"},
       "", "", "true for glTF, false for Mitsuba scenes"},
      {{"solid_tint", "twice", "glTF: whether the base color of solid glass tints light as it enters and again as it leaves (glTF), or once in all (Blender)",
        -kMany, kMany, {"twice", "once"}}, "", ""},
      {{"frames", "", "frames to render, e.g. 1-24, 1..24, 1-100x2, 1-100:2 or a comma list of those"}, "-f,--frames", "SET",
       "the frames that the scene's animation covers; else first_frame", true},
      {{"fps", 24.0, "frames per second", 1e-3, 1e6}, "--fps", "N"},
      {{"first_frame", 0, "number of the frame that stands at `start`", -1e9, 1e9}, "", "N"},
      {{"start", 0.0, "time of `first_frame` on the scene's axis, seconds", -1e9, 1e9}, "", "SECONDS",
       "the scene's start of exposure, else 0"},
      {{"motion_segments", "auto", "segments of a frame between which motion is interpolated, 1 to 1024; auto: as many as the motion needs, one number for the whole shot"}, "", "N", "", true},
      {{"cuts", "", "first frames after cuts: motion ends there, and nothing looks across; jumps of the camera are found without it"}, "", "FRAMES", "", true},

      {{"quality", "as_told", "draft, final: clean frames, from 8 or 64 samples a pixel and by the stage denoise; see docs/denoising.md. fast: the same of every "
        "fourth frame at half the width and height; the rest and motion blur are made of these; see docs/motion-stages.md. What the "
        "shot or the command line say themselves stays", -kMany, kMany, {"as_told", "draft", "final", "fast"}}, "--quality", "NAME"},
      {{"stages", "", "what follows the render, in this order; `tempera list stages` names them, and each has a table; []: nothing. The integrator is "
       "asked for the layers that those named here can use; the result holds those of output.layers"}, "", "A,B", "", true},
      {{"guides.spp", 8, "samples per pixel of guides: frames that the stages interpolate and upsample take what is seen from", 1, 1e6}, "", "N"},
      {{"halo", -1, "frames at most that are made around those asked for, on either side, where stages look at several; beyond them the shot is "
        "taken to end; -1: as many as the stages look at", -1, 1e9}, "", "N"},

      {{"shutter.open", 0.0, "start of exposure, in frames from the frame's time", -10, 10}, "", "FRAMES", "the scene's, else 0"},
      {{"shutter.close", 0.5, "end of exposure; as `open` for no motion blur", -10, 10}, "", "FRAMES", "the scene's, else 0.5"},
      {{"shutter.shape", "box", "transmittance over the exposure", -kMany, kMany, {"box", "trapezoid", "curve"}}, "", "SHAPE"},
      {{"shutter.ramp_in", 0.25, "trapezoid: part of the exposure spent opening", 0, 1}, "", "FRACTION"},
      {{"shutter.ramp_out", 0.25, "trapezoid: part of the exposure spent closing", 0, 1}, "", "FRACTION"},
      {{"shutter.curve", "", "curve: transmittance at equally spaced times"}, "", "NUMBERS", "", true},
      {{"shutter.rolling", 0.0, "delay of the last scan line against the first, in frames", -10, 10}, "", "FRAMES"},

      {{"film.resolution", "", "width and height of the picture in pixels"}, "--resolution", "WxH", "the scene's, else 1280x720", true},
      {{"film.scale", 100.0, "percentage of the resolution that is rendered; fractions of pixels are cut off", 0.1, 1000}, "--resolution-scale", "PERCENT"},
      {{"film.crop", "", "part of the picture to render: left, top, width, height in pixels of the full resolution"}, "--crop", "X,Y,W,H",
       "the scene's, else the whole picture", true},
      {{"film.mask", "", "image of the picture's size or the crop window's, or names such as mask.####.exr: only pixels that are above 0 in its layer "
                         "mask, or its only layer, are rendered, each as in the whole picture"}, "--mask", "FILE"},
      {{"film.filter", "box", "pixel filter", -kMany, kMany, {"box", "tent", "gaussian", "mitchell", "blackman_harris"}},
       "--filter", "NAME[:RADIUS]", "the scene's, else box"},
      {{"film.filter_radius", 0.0, "radius of the filter in pixels; 0: the filter's usual one", 0, 16}, "", "PIXELS"},

      {{"camera.name", "", "as `camera`, which cannot stand beside this table in one file"}, "", "NAME", "the scene's first or active one"},

      {{"sampling.spp", 64, "samples per pixel", 1, 1 << 24}, "--spp", "N", "the scene's, else 64"},
      {{"sampling.seed", 0, "seed of all random numbers", 0, kMany}, "--seed", "N"},
      {{"sampling.seed_per_frame", true, "false: every frame has the same noise pattern"}, "", ""},
      {{"sampling.sampler", "sobol", "random numbers", -kMany, kMany, {"sobol", "independent"}}, "--sampler", "NAME"},

      {{"integrator.name", "path", "integrator; its parameters are the other keys of this table, or --param"}, "--integrator", "NAME", "the scene's, else path"},

      {{"output.path", "", "rendered frames, relative to the current directory: a folder, or names such as out/f.####.exr; see docs/shot.md"},
       "-o,--output", "PATH", "for run out/NAME/NAME.####.exr"},
      {{"output.layers", "color", "layers to write besides color; `tempera list layers` names them"}, "--layers", "A,B,C", "", true},
      {{"output.aov_names", "tempera", "whose names the layers get in the file", -kMany, kMany,
        {"tempera", "blender", "arnold", "renderman", "pbrt"}}, "--aov-names", "NAME"},
      {{"output.view_layer", "ViewLayer", "first part of Blender's names"}, "--view-layer", "NAME"},
      {{"output.compression", "zip", "EXR compression", -kMany, kMany, {"none", "rle", "zips", "zip", "piz", "dwaa"}}, "", "NAME"},
      {{"output.half", false, "16-bit floats for radiance and reflectance layers"}, "--half", ""},
      {{"output.cryptomatte_depth", 6, "objects that cryptomatte keeps per pixel", 2, 16}, "", "N"},

      {{"environment.image", "", "latitude-longitude image that lights the scene, in place of the scene's own environment"}, "", "FILE"},
      {{"environment.radiance", "", "constant radiance, or factor of the image: a number or three"}, "", "RGB", "1 if any key of this table is given", true},
      {{"environment.color_space", "", "what the image's numbers are, e.g. srgb_rec709_scene"}, "", "NAME", "what the file says, else sRGB for integers and linear for floats"},
      {{"environment.rotation", "0", "turn about the vertical axis in degrees, counterclockwise from above; or the three angles x, y, z of "
        "Blender's mapping of its world's texture, for which [0, 0, a] is 90 - a"}, "", "DEGREES", "", true},
      {{"environment.camera_visible", true, "whether the camera sees it"}, "", ""},
      {{"environment.keep", false, "add to the scene's own environment instead of replacing it"}, "", ""},

      {{"video.path", "", "movie that run makes, relative to the current directory"}, "", "FILE",
       "NAME.mp4 next to the rendered frames"},
      {{"video.fps", 0.0, "frame rate of the movie; 0: that of the shot", 0, 1000}, "", "N"},
      {{"video.codec", "auto", "auto (by the file's ending), h264, hevc, vp9, av1 or ffv1", -kMany, kMany,
        {"auto", "h264", "hevc", "vp9", "av1", "ffv1"}}, "", "NAME"},
      {{"video.crf", 18, "quality: 0 (best) to 51", 0, 51}, "", "N"},
      {{"video.layer", "color", "layer to show"}, "", "NAME"},
      {{"video.exposure", 0.0, "stops: values are multiplied by 2^exposure", -64, 64}, "", "STOPS"},
      {{"video.tone_map", "srgb", "from linear to display values", -kMany, kMany, {"srgb", "filmic", "none"}}, "", "NAME"},
      // clang-format on
  };
}

/// With the parameters of cameras below the keys that are the shot's own in their table, and the tables of the stages
/// before what is made of their frames.
std::vector<ShotKey> all_keys() {
  std::vector<ShotKey> all = own_keys();
  const auto add = [&](const std::string& table, const char* after, std::span<const ParamSpec> params, bool of_scene) {
    auto at = std::find_if(all.begin(), all.end(), [&](const ShotKey& k) { return k.spec.name == after; });
    for (const ParamSpec& s : params) {
      ShotKey key{s, ""};
      key.spec.name = table + s.name;
      if (of_scene) key.fallback_help = "the scene's";
      key.list = key.keyframes = of_scene && std::holds_alternative<std::string>(s.fallback) && s.choices.empty();
      at = all.insert(std::next(at), std::move(key));
    }
  };
  add("camera.", "camera.name", camera_params(), true);
  std::string automatic;
  for (const StageEntry* e : stage_catalog()) {
    if (!e->inserted_help.empty()) continue;
    ShotKey path{{e->name + ".path", "",
                  e->output_help + " that run makes, where this stage is among those of the shot; as output.path"},
                 "",
                 "PATH",
                 "next to the rendered frames a folder final for the last stage, else called like the stage"};
    const auto video =
        std::find_if(all.begin(), all.end(), [](const ShotKey& k) { return k.spec.name.starts_with("video."); });
    all.insert(video, std::move(path));
    add(e->name + ".", (e->name + ".path").c_str(), e->params, false);
    if (e->follows) automatic += fmt::format("{}{} after {}", automatic.empty() ? "" : ", ", e->name, e->follows_help);
  }
  for (ShotKey& k : all) {
    if (k.spec.name == "stages") k.fallback_help = automatic + "; those of a quality";
  }
  return all;
}
}  // namespace

std::span<const ShotKey> shot_keys() {
  static const std::vector<ShotKey> table = all_keys();
  return table;
}

std::span<const OpenTable> shot_tables() {
  static const std::vector<OpenTable> tables = {
      {"integrator", "parameter", "parameters of the integrator; `tempera list integrators` names them"},
      {"classes", "name", "light-path classes to write as layers class.<name>.color: name = \"expression\""},
      {"decompose", "name",
       "as classes, but checked to be disjoint; with the layer class.residual.color they add up to color. `tree = "
       "\"default\"` stands for emission, direct, indirect, caustic, reflection and transmission"},
      {"define", "name", "values of the scene file's own parameters (Mitsuba's $name)"},
      {"materials", "material",
       "materials that replace those of this name in the scene: type and its parameters; without a type, opacity, "
       "two_sided and emission change the scene's own",
       2},
      {"cameras", "camera", "as [camera], for the camera of this name whether or not it renders", 2},
      {"lights", "light", "changes of the light, or of the emitting object, of this name", 2},
      {"caches", "mesh", "vertex cache that moves the object's or mesh's vertices", 2},
  };
  return tables;
}

}  // namespace tempera
