// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/scene_edits.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <map>
#include <set>

#include "tempera/core/log.h"
#include "tempera/pipeline/materials.h"
#include "tempera/scene/light_shape.h"

namespace tempera {

namespace {

constexpr double kDegrees = kPiD / 180;
constexpr double kMany = 1e300, kHuge = 1e9;

/// The values that one table gives, and where.
struct Values {
  Params params;
  std::map<std::string, SourceLoc> locs;
  SourceLoc first;  ///< where the table's first value stands

  explicit Values(std::span<const ParamSpec> specs) : params(specs) {}
  void set(const std::string& name, const ShotValue& value) {
    params.set_text(name, to_text(value.value), value.loc);
    if (locs.empty()) first = value.loc;
    locs[name] = value.loc;
  }
  bool has(const std::string& name) const { return params.has(name); }
  SourceLoc loc(const std::string& name) const {
    const auto it = locs.find(name);
    return it == locs.end() ? first : it->second;
  }
  Error bad(const std::string& name, const std::string& why) const {
    return Error(ErrorCode::kBadInput, loc(name), fmt::format("{} {}", name, why));
  }
  Animated<float> keys(const std::string& name, const FrameClock& clock, double min, double max) const {
    return parse_keys(name, params.get_string(name), clock, loc(name), min, max);
  }
  std::string canonical() const {
    std::string text;
    for (const auto& [name, unused] : locs) {
      for (const ParamSpec& s : params.specs()) {
        if (s.name == name) text += fmt::format("{}={},", name, value_text(s));
      }
    }
    return text;
  }

 private:
  std::string value_text(const ParamSpec& s) const {
    switch (s.fallback.index()) {
      case 0:
        return to_text(ParamValue(params.get_bool(s.name)));
      case 1:
        return to_text(ParamValue(params.get_int(s.name)));
      case 2:
        return to_text(ParamValue(params.get_double(s.name)));
      default:
        return params.get_string(s.name);
    }
  }
};

/// The tables of tables called `table`, by name.
std::map<std::string, Values> tables(const ShotConfig& config, const std::string& table,
                                     std::span<const ParamSpec> specs) {
  std::map<std::string, Values> result;
  for (const auto& [key, value] : config.table(table)) {
    result.try_emplace(key[0], specs).first->second.set(key[1], value);
  }
  return result;
}

Error unknown(const Values& values, const char* kind, const std::string& wanted, std::vector<std::string> names) {
  std::sort(names.begin(), names.end());
  names.erase(std::unique(names.begin(), names.end()), names.end());
  std::erase(names, "");
  return Error(ErrorCode::kUnknownName, values.first,
               names.empty()
                   ? fmt::format("the scene has no {} \"{}\", and none with a name at all", kind, wanted)
                   : fmt::format("the scene has no {} \"{}\"; it has: {}", kind, wanted, nearest_names(wanted, names)));
}

double frame_time(const FrameClock& clock, double frame) { return clock.start + (frame - clock.first) / clock.fps; }

/// f over the values of `a`, which are linear between keys, where f is not.
Animated<float> mapped(const Animated<float>& a, const std::function<double(double)>& f) {
  if (a.is_constant()) return float(f(double(a.at(0))));
  constexpr int kParts = 16;
  std::vector<double> times;
  std::vector<float> values;
  for (std::size_t i = 0; i < a.times().size(); ++i) {
    const double t0 = a.times()[i];
    const int parts = i + 1 < a.times().size() && a.value(i) != a.value(i + 1) ? kParts : 1;
    for (int k = 0; k < parts; ++k) {
      const double t = k == 0 ? t0 : t0 + (a.times()[i + 1] - t0) * k / kParts;
      if (!times.empty() && !(t > times.back())) continue;
      times.push_back(t);
      values.push_back(float(f(double(a.at(t)))));
    }
  }
  return {times, values, Interpolation::kLinear};
}

}  // namespace

Animated<float> parse_keys(const std::string& name, const std::string& text, const FrameClock& clock,
                           const SourceLoc& loc, double min, double max) {
  const auto fail = [&] {
    return Error(
        ErrorCode::kBadInput, loc,
        fmt::format("{} = \"{}\" cannot be read; write a number, or keys as [[frame, value], ...] or \"frame:value, "
                    "...\"",
                    name, text));
  };
  std::vector<double> times;
  std::vector<float> values;
  const char* at = text.data();
  const char* const end = text.data() + text.size();
  const auto skip = [&] {
    while (at != end && *at == ' ') ++at;
  };
  const auto number = [&] {
    skip();
    double v = 0;
    const auto [next, ec] = std::from_chars(at, end, v);
    if (ec != std::errc() || !std::isfinite(v)) throw fail();
    at = next;
    skip();
    return v;
  };
  for (;;) {
    double v = number();
    const bool keyed = at != end && *at == ':';
    if (keyed) {
      const double t = frame_time(clock, v);
      ++at;
      v = number();
      if (!times.empty() && !(t > times.back())) {
        throw Error(ErrorCode::kBadInput, loc, fmt::format("{} = \"{}\": frames of keys must increase", name, text));
      }
      times.push_back(t);
    }
    if (!(v >= min && v <= max)) {
      throw Error(
          ErrorCode::kOutOfRange, loc,
          fmt::format("{} = {} is out of range; must be {}", name, v,
                      max < kHuge ? fmt::format("between {} and {}", min, max) : fmt::format("at least {}", min)));
    }
    values.push_back(float(v));
    if (at == end) break;
    if (!keyed || *at++ != ',') throw fail();
  }
  if (times.empty()) return values[0];
  if (times.size() != values.size()) throw fail();  // a bare number at the end of keys
  return {times, values, Interpolation::kLinear};
}

std::span<const ParamSpec> camera_params() {
  static const std::vector<ParamSpec> params = {
      {"fov", "", "angle of view along the side that sensor_fit names, degrees; keys as for f_stop"},
      {"focal_length", "", "millimeters, in place of fov; keys as for f_stop"},
      {"sensor_width", 36.0, "millimeters that the side of the picture has on the sensor", 1e-3, 1e6},
      {"sensor_height", 24.0, "the same with sensor_fit = \"vertical\"", 1e-3, 1e6},
      {"sensor_fit",
       "auto",
       "the side: auto (the larger one), horizontal or vertical",
       -kMany,
       kMany,
       {"auto", "horizontal", "vertical"}},
      {"shift_x", 0.0, "moves the window to the right, in lengths of that side", -100, 100},
      {"shift_y", 0.0, "moves the window up, in lengths of that side", -100, 100},
      {"f_stop", "",
       "depth of field: the lens has a radius of focal length / (2 f_stop); a number, or keys over frames that are "
       "linear in between: [[1, 2.8], [24, 8]]"},
      {"aperture_radius", "", "the radius itself, in meters, in place of f_stop; 0: all is sharp; keys as for f_stop"},
      {"focus_distance", "", "of what is sharp, in meters along the view axis; keys as for f_stop"},
      {"focus_object", "", "object whose origin is sharp, in place of focus_distance"},
      {"pixel_aspect", 1.0, "width of a pixel over its height", 1e-3, 1e3},
      {"near_clip", 0.01, "meters along the view axis from where the camera sees", 0, 1e18},
      {"far_clip", 1e7, "meters along the view axis up to where the camera sees", 1e-30, 1e18},
  };
  return params;
}

namespace {

int find_node(const Scene& scene, const Values& values, const std::string& wanted) {
  std::vector<std::string> names;
  for (int i = 0; i < std::ssize(scene.nodes); ++i) {
    if (scene.nodes[i].name == wanted) return i;
    names.push_back(scene.nodes[i].name);
  }
  for (const Instance& i : scene.instances) {
    if (i.name == wanted && i.node >= 0) return i.node;
    if (i.node >= 0) names.push_back(i.name);
  }
  Values at = values;
  at.first = values.loc("focus_object");
  throw unknown(at, "object", wanted, names);
}

void edit_camera(const Values& v, const RenderSettings& s, const Scene& scene, Camera& camera) {
  const bool perspective = camera.projection == Projection::kPerspective;
  if (v.has("pixel_aspect")) camera.pixel_aspect = float(v.params.get_double("pixel_aspect"));
  const double aspect = double(s.width) / s.height * double(camera.pixel_aspect);
  if (v.has("sensor_fit") || v.has("sensor_width") || v.has("sensor_height")) {
    const std::string& fit = v.params.get_string("sensor_fit");
    camera.sensor_fit = fit == "auto"         ? SensorFit::kAuto
                        : fit == "horizontal" ? SensorFit::kHorizontal
                                              : SensorFit::kVertical;
    camera.sensor_size =
        float(v.params.get_double(camera.sensor_fit == SensorFit::kVertical ? "sensor_height" : "sensor_width") / 1000);
  }
  const bool across =
      camera.sensor_fit == SensorFit::kHorizontal || (camera.sensor_fit == SensorFit::kAuto && aspect >= 1);

  for (const char* name : {"fov", "focal_length"}) {
    if (v.has(name) && !perspective) throw v.bad(name, "cannot be set: an orthographic camera has none");
  }
  if (v.has("fov") && v.has("focal_length")) throw v.bad("focal_length", "and fov exclude each other");
  if (v.has("fov") || v.has("focal_length")) {
    camera.fov_x = v.has("fov") ? mapped(v.keys("fov", s.clock, 1e-3, 179.9), [](double fov) { return fov * kDegrees; })
                                : mapped(v.keys("focal_length", s.clock, 1e-3, 1e6),
                                         [&](double f) { return 2 * std::atan(double(camera.sensor_size) * 500 / f); });
    camera.keep_vertical_fov = !across;
    camera.authored_aspect = across ? float(aspect) : 1.0f;  // 1: fov_x is the vertical angle
  }
  // The window moves by lengths of the fitted side; the picture on it moves the other way.
  if (v.has("shift_x")) {
    camera.principal_offset.x = float(-v.params.get_double("shift_x") * (across ? 1 : 1 / aspect));
  }
  if (v.has("shift_y")) {
    camera.principal_offset.y = float(v.params.get_double("shift_y") * (across ? aspect : 1));
  }

  const bool had_lens = camera.aperture_radius.at(s.clock.start) > 0 || camera.f_stop.at(s.clock.start) > 0;
  if (v.has("f_stop") && v.has("aperture_radius")) throw v.bad("aperture_radius", "and f_stop exclude each other");
  if (v.has("f_stop")) camera.f_stop = v.keys("f_stop", s.clock, 1e-3, 1e6);
  if (v.has("aperture_radius")) {
    camera.aperture_radius = v.keys("aperture_radius", s.clock, 0, kHuge);
    camera.f_stop = 0.0f;
  }
  if (v.has("focus_distance") && v.has("focus_object"))
    throw v.bad("focus_object", "and focus_distance exclude each other");
  if (v.has("focus_distance")) {
    camera.focus_distance = v.keys("focus_distance", s.clock, 1e-6, kHuge);
    camera.focus_node = -1;
  }
  if (v.has("focus_object")) camera.focus_node = find_node(scene, v, v.params.get_string("focus_object"));
  const auto is_open = [](const Animated<float>& a) {
    return std::any_of(a.values().begin(), a.values().end(), [](float r) { return r > 0; });
  };
  const char* lens = v.has("f_stop") ? "f_stop" : "aperture_radius";
  if ((v.has("f_stop") || (v.has("aperture_radius") && is_open(camera.aperture_radius))) && !had_lens &&
      camera.focus_node < 0 && !v.has("focus_distance")) {
    throw v.bad(lens, "needs to know what is sharp: add focus_distance or focus_object");
  }

  if (v.has("near_clip")) camera.near_clip = float(v.params.get_double("near_clip"));
  if (v.has("far_clip")) camera.far_clip = float(v.params.get_double("far_clip"));
  if (!(camera.near_clip < camera.far_clip)) {
    throw Error(ErrorCode::kOutOfRange, v.loc(v.has("near_clip") ? "near_clip" : "far_clip"),
                fmt::format("near_clip {} is not below far_clip {}", camera.near_clip, camera.far_clip));
  }
}

}  // namespace

std::string edit_cameras(const ShotConfig& config, const RenderSettings& settings, Scene& scene) {
  std::string edits;
  for (const auto& [name, values] : tables(config, "cameras", camera_params())) {
    std::vector<std::string> names;
    int found = -1;
    for (int i = 0; i < std::ssize(scene.cameras); ++i) {
      names.push_back(scene.cameras[i].name);
      if (found < 0 && scene.cameras[i].name == name) found = i;
    }
    if (found < 0) throw unknown(values, "camera", name, names);
    edit_camera(values, settings, scene, scene.cameras[found]);
    edits += fmt::format("camera:{}.{};", found, values.canonical());
  }
  Values own(camera_params());
  for (const ParamSpec& s : camera_params()) {
    if (const ShotValue* v = config.find("camera." + s.name)) own.set(s.name, *v);
  }
  if (own.locs.empty()) return edits;
  edit_camera(own, settings, scene, scene.cameras[settings.camera]);
  return edits + fmt::format("camera:{};", own.canonical());
}

std::span<const ParamSpec> light_params() {
  static const std::vector<ParamSpec> params = {
      {"color", "",
       "a number, three (linear Rec. 709) or \"#rrggbb\"; what the light gives is color x intensity x scale"},
      {"intensity", "",
       "W/sr of points and spots, W/m^2 of suns, W/(m^2 sr) of emitting objects; in files where the color holds "
       "everything it is 1; a number, or keys over frames that are linear in between: [[1, 5], [24, 0]]"},
      {"scale", 1.0, "factor", 0, 1e30},
      {"radius", 0.0, "points and spots: a sphere of this radius in meters that gives the same power; 0: none", 0, 1e9},
      {"angle", 0.0, "suns: degrees that the disk in the sky spans, with the same irradiance; 0: a point", 0, 180},
      {"cone", 0.0, "spots: full angle of the cone in degrees", 0.01, 180},
      {"beam", 0.0, "spots: full angle in degrees up to which there is full light", 0, 180},
      {"blend", 0.0, "spots: softness of the rim in [0,1], as Blender has it; in place of beam", 0, 1},
      {"spread", 180.0,
       "emitting objects: full angle in degrees around the normal into which all light goes, as through a grid of "
       "slats, with the same power; 180: evenly",
       1, 180},
      {"two_sided", false, "emitting objects: the back shines, too"},
      {"camera_visible", false,
       "whether the camera sees it: spheres of `radius` and disks of `angle`, which it does not unless told so, and "
       "emitting objects"},
  };
  return params;
}

namespace {

bool emits(const Scene& scene, const Instance& instance) {
  const auto& group = scene.groups[instance.group];
  return std::any_of(group.begin(), group.end(), [&](int s) { return scene.shapes[s].emission.has_value(); });
}

/// Emitting instances that `name` means: objects, or all that use a shape of that name.
std::vector<std::size_t> emitting_instances(const Scene& scene, const std::string& name) {
  std::vector<std::size_t> by_object, by_shape;
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const Instance& instance = scene.instances[i];
    if (!emits(scene, instance)) continue;
    if (instance.name == name) by_object.push_back(i);
    const auto& group = scene.groups[instance.group];
    if (std::any_of(group.begin(), group.end(), [&](int s) { return scene.shapes[s].name == name; }))
      by_shape.push_back(i);
  }
  return by_object.empty() ? by_shape : by_object;
}

Rgb light_color(const Values& v) {
  const auto c = parse_color(v.params.get_string("color"));
  if (!c || std::min({c->r, c->g, c->b}) < 0) {
    throw v.bad("color", fmt::format("= \"{}\" is no color; write a number, three numbers from 0 up or \"#rrggbb\"",
                                     v.params.get_string("color")));
  }
  return *c;
}

void refuse(const Values& v, std::initializer_list<const char*> names, const std::string& what) {
  for (const char* name : names) {
    if (v.has(name)) throw v.bad(name, fmt::format("does not apply: {}", what));
  }
}

void edit_punctual(const Values& v, const FrameClock& clock, PunctualLight& light) {
  static constexpr const char* kKinds[] = {"a point light", "a spot light", "a directional light", "a projector"};
  const std::string what = fmt::format("\"{}\" is {}", light.name, kKinds[int(light.type)]);
  refuse(v, {"spread", "two_sided"}, what);
  if (light.type != LightType::kPoint && light.type != LightType::kSpot) refuse(v, {"radius"}, what);
  if (light.type != LightType::kDirectional) refuse(v, {"angle"}, what);
  if (light.type != LightType::kSpot) refuse(v, {"cone", "beam", "blend"}, what);
  if (v.has("color")) light.intensity = light_color(v);
  if (v.has("intensity")) light.intensity_scale = v.keys("intensity", clock, 0, 1e30);
  if (v.has("scale")) light.intensity = product(light.intensity, Animated<float>(float(v.params.get_double("scale"))));
  if (v.has("cone")) {
    light.cutoff_angle = float(v.params.get_double("cone") * kDegrees / 2);
    if (!v.has("beam") && !v.has("blend") && light.falloff == SpotFalloff::kSmoothstep) light.beam_width = 0.0f;
  }
  if (v.has("beam") && v.has("blend")) throw v.bad("blend", "and beam exclude each other");
  if (v.has("beam")) {
    light.beam_width = float(v.params.get_double("beam") * kDegrees / 2);
    if (light.beam_width.at(clock.start) > light.cutoff_angle.at(clock.start)) {
      throw Error(ErrorCode::kOutOfRange, v.loc("beam"),
                  fmt::format("beam = {} is more than the cone's {:.4g} degrees", v.params.get_double("beam"),
                              double(light.cutoff_angle.at(clock.start)) * 2 / kDegrees));
    }
  }
  if (v.has("blend")) {
    light.falloff = SpotFalloff::kSmoothstep;
    light.beam_width = mapped(light.cutoff_angle, [blend = v.params.get_double("blend")](double cutoff) {
      const double outer = std::cos(cutoff);
      return std::acos(std::clamp(outer + (1 - outer) * blend, -1.0, 1.0));
    });
  }
  if (v.has("angle")) {
    const double angle = v.params.get_double("angle");
    if (angle > 0 && angle < 0.01) throw v.bad("angle", fmt::format("= {} is neither 0 nor at least 0.01", angle));
    light.angle = float(angle * kDegrees);
  }
  const bool has_size = light.angle > 0 || v.params.get_double("radius") > 0;
  if (v.has("camera_visible")) {
    if (!has_size && v.params.get_bool("camera_visible"))
      throw v.bad("camera_visible", "does not apply: a light without a size cannot be seen; add a radius or an angle");
    light.camera_visible = v.params.get_bool("camera_visible");
  }
}

void edit_emitting(const Values& v, const FrameClock& clock, Scene& scene, std::size_t index) {
  refuse(v, {"radius", "angle", "cone", "beam", "blend"},
         fmt::format("\"{}\" is an emitting object", scene.instances[index].name));
  Instance& instance = scene.instances[index];
  const auto users = std::count_if(scene.instances.begin(), scene.instances.end(),
                                   [&](const Instance& i) { return i.group == instance.group; });
  if (users > 1) {  // the others keep theirs
    std::vector<int> group = scene.groups[instance.group];
    for (int& s : group) {
      if (!scene.shapes[s].emission) continue;
      scene.shapes.push_back(Shape(scene.shapes[s]));
      s = int(scene.shapes.size()) - 1;
    }
    instance.group = int(scene.groups.size());
    scene.groups.push_back(std::move(group));
  }
  if (v.has("camera_visible")) instance.camera_visible = v.params.get_bool("camera_visible");
  for (const int s : scene.groups[instance.group]) {
    auto& emission = scene.shapes[s].emission;
    if (!emission) continue;
    Animated<Rgb>& factor = emission->radiance.factor;
    if (v.has("color")) factor = light_color(v);
    if (v.has("intensity")) factor = product(factor, v.keys("intensity", clock, 0, 1e30));
    if (v.has("scale")) factor = product(factor, Animated<float>(float(v.params.get_double("scale"))));
    if (v.has("two_sided")) emission->two_sided = v.params.get_bool("two_sided");
    if (v.has("spread")) {
      const double spread = v.params.get_double("spread");
      emission->half_spread = spread >= 180 ? kPi / 2 : float(spread * kDegrees / 2);
    }
  }
}

}  // namespace

std::string edit_lights(const ShotConfig& config, const FrameClock& clock, Scene& scene) {
  std::string edits;
  std::map<int, float> radii;  // by light: made into spheres at the end, as that takes lights out of the list
  std::vector<std::pair<const Values*, std::size_t>> emitting;
  const auto all = tables(config, "lights", light_params());
  for (const auto& [name, values] : all) {
    std::vector<std::string> names;
    bool found = false;
    for (int i = 0; i < std::ssize(scene.lights); ++i) {
      PunctualLight& light = scene.lights[i];
      names.push_back(light.name);
      const int parent = light.node >= 0 ? scene.nodes[light.node].parent : -1;
      if (light.name != name && (parent < 0 || scene.nodes[parent].name != name)) continue;
      found = true;
      edit_punctual(values, clock, light);
      if (const double radius = values.params.get_double("radius"); radius > 0) radii[i] = float(radius);
    }
    for (const Instance& i : scene.instances) {
      if (emits(scene, i)) names.push_back(i.name);
    }
    if (!found) {
      for (const std::size_t i : emitting_instances(scene, name)) emitting.emplace_back(&values, i), found = true;
    }
    if (!found) throw unknown(values, "light or emitting object", name, names);
    edits += fmt::format("light:{}.{};", name, values.canonical());
  }
  for (const auto& [values, i] : emitting) edit_emitting(*values, clock, scene, i);
  for (auto it = radii.rbegin(); it != radii.rend(); ++it) {
    make_sphere_light(scene, it->first, it->second, scene.lights[it->first].camera_visible);
  }
  return edits;
}

std::span<const ParamSpec> cache_params() {
  static const std::vector<ParamSpec> params = {
      {"file", "", "file of positions: .pc2, .mdd, or floats alone; relative to shot.toml"},
      {"format",
       "auto",
       "auto: by the file's ending, raw for all but .pc2 and .mdd",
       -kMany,
       kMany,
       {"auto", "pc2", "mdd", "raw"}},
      {"up",
       "y",
       "axis of the file's positions that points up: y as in glTF, z as in Blender (x, y, z becomes x, z, -y)",
       -kMany,
       kMany,
       {"y", "z"}},
      {"start", 0.0, "frame of the first sample, in place of what the file says", -1e9, 1e9},
      {"step", 1.0, "frames between samples, in place of what the file says", 1e-6, 1e6},
      {"frames", "", "the frames of all samples, in place of start and step"},
      {"vertices", 0, "raw: vertices of a sample; 0: as many as the mesh has", 0, 2147483647},
      {"offset", 0, "raw: bytes before the first position", 0, 2147483647},
  };
  return params;
}

namespace {

struct CachedMesh {
  std::vector<int> shapes;   ///< meshes that the name means
  std::size_t vertices = 0;  ///< of all of them
  std::size_t sources = 0;   ///< of the authored mesh, as far as they are used; 0: they do not all tell
};

CachedMesh find_meshes(const Scene& scene, const Values& v, const std::string& name) {
  CachedMesh result;
  std::vector<std::string> names;
  const auto add = [&](int s) {
    if (std::holds_alternative<Mesh>(scene.shapes[s].geometry) &&
        std::find(result.shapes.begin(), result.shapes.end(), s) == result.shapes.end()) {
      result.shapes.push_back(s);
    }
  };
  for (const Instance& i : scene.instances) {
    names.push_back(i.name);
    if (i.name != name) continue;
    for (const int s : scene.groups[i.group]) add(s);
  }
  for (int s = 0; result.shapes.empty() && s < std::ssize(scene.shapes); ++s) {
    // A mesh of several materials is several shapes, NAME[0], NAME[1], ...
    const std::string& own = scene.shapes[s].name;
    names.push_back(own);
    if (own == name) add(s);
  }
  if (result.shapes.empty()) {
    for (int s = 0; s < std::ssize(scene.shapes); ++s) {
      if (scene.shapes[s].name == fmt::format("{}[{}]", name, result.shapes.size())) add(s);
    }
  }
  if (result.shapes.empty()) throw unknown(v, "mesh", name, names);
  bool mapped = true;
  for (const int s : result.shapes) {
    const Mesh& mesh = std::get<Mesh>(scene.shapes[s].geometry);
    result.vertices += mesh.positions.size();
    mapped = mapped && !mesh.source_vertices.empty();
    for (const std::size_t i : mesh.source_vertices) result.sources = std::max(result.sources, i + 1);
  }
  if (!mapped) result.sources = 0;
  return result;
}

constexpr Affine3f kFromZUp{{1, 0, 0}, {0, 0, -1}, {0, 1, 0}};

/// Mean squared distance of sample 0 to the mesh as it is in the scene.
double distance_to_rest(const Mesh& mesh, const CachedPositions& c, const Affine3f& map) {
  double sum = 0;
  for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
    const std::size_t at = c.vertices.empty() ? c.first_vertex + v : c.vertices[v];
    sum += double(length_squared(map.point(c.samples->position(0, at)) - mesh.positions[v]));
  }
  return sum / double(std::max<std::size_t>(1, mesh.positions.size()));
}

std::vector<double> sample_times(const Values& v, const FrameClock& clock, CacheFormat format,
                                 const VertexCache& cache) {
  const std::size_t n = cache.samples();
  std::vector<double> frames = cache.times();
  if (format == CacheFormat::kMdd) {
    for (double& t : frames) t *= clock.fps;  // seconds
  }
  if (v.has("frames")) {
    if (v.has("start") || v.has("step")) throw v.bad("frames", "and start or step exclude each other");
    frames.clear();
    const std::string& text = v.params.get_string("frames");
    const char* at = text.data();
    const char* const end = at + text.size();
    while (at != end) {
      double f = 0;
      const auto [next, ec] = std::from_chars(at, end, f);
      if (ec != std::errc() || !std::isfinite(f) || (next != end && *next != ','))
        throw v.bad("frames", fmt::format("= \"{}\" cannot be read; write numbers, e.g. [1, 1.5, 2]", text));
      frames.push_back(f);
      for (at = next; at != end && (*at == ',' || *at == ' ');) ++at;
    }
    if (frames.size() != n)
      throw v.bad("frames", fmt::format("names {} frames, but the file has {} samples", frames.size(), n));
  } else if (v.has("step")) {
    const double first = v.has("start") ? v.params.get_double("start") : frames[0];
    for (std::size_t i = 0; i < n; ++i) frames[i] = first + double(i) * v.params.get_double("step");
  } else if (v.has("start")) {
    const double shift = v.params.get_double("start") - frames[0];
    for (double& f : frames) f += shift;
  }
  for (double& f : frames) f = frame_time(clock, f);
  for (std::size_t i = 0; i < n; ++i) {
    if (!std::isfinite(frames[i]) || (i > 0 && !(frames[i] > frames[i - 1]))) {
      throw v.bad(v.has("frames") ? "frames" : "file",
                  fmt::format("has times that do not increase (sample {}); say start and step", i));
    }
  }
  return frames;
}

}  // namespace

std::string attach_caches(const ShotConfig& config, const FrameClock& clock, Scene& scene) {
  std::string edits;
  for (const auto& [name, v] : tables(config, "caches", cache_params())) {
    const CachedMesh target = find_meshes(scene, v, name);
    if (v.params.get_string("file").empty())
      throw v.bad("file", fmt::format("is missing: [caches.{}] names none", name));
    const std::filesystem::path file = config.input_path({v.params.get_string("file"), v.loc("file")});
    std::string ending = file.extension().string();
    std::transform(ending.begin(), ending.end(), ending.begin(), [](unsigned char c) { return char(std::tolower(c)); });
    const std::string& wanted = v.params.get_string("format");
    const std::string format = wanted != "auto" ? wanted : ending == ".pc2" ? "pc2" : ending == ".mdd" ? "mdd" : "raw";
    VertexCacheOptions options;
    options.format = format == "pc2" ? CacheFormat::kPc2 : format == "mdd" ? CacheFormat::kMdd : CacheFormat::kRaw;
    if (options.format != CacheFormat::kRaw) refuse(v, {"vertices", "offset"}, "the file says so itself");
    const int vertices = v.params.get_int("vertices");
    options.vertices = vertices > 0 ? vertices : target.vertices;
    options.offset = v.params.get_int("offset");
    if (options.format == CacheFormat::kRaw && vertices == 0 && target.sources > 0)
      throw v.bad("file", "needs `vertices`: the mesh was split at seams, and does not tell how many it had");
    const std::shared_ptr<VertexCache> cache = VertexCache::open(file, options, v.loc("file"));
    cache->set_times(sample_times(v, clock, options.format, *cache));

    const bool z_up = v.params.get_string("up") == "z";
    std::uint32_t first = 0;
    double distance = 0, other = 0;
    for (const int s : target.shapes) {
      Mesh& mesh = std::get<Mesh>(scene.shapes[s].geometry);
      CachedPositions c;
      c.samples = cache;
      c.mesh_from_cache = z_up ? kFromZUp : Affine3f{};
      if (target.sources > 0 && (target.vertices != cache->vertices() || target.sources == cache->vertices())) {
        if (target.sources > cache->vertices()) {
          throw v.bad("file", fmt::format("has {} vertices, but _ORIGINAL_INDEX of the mesh \"{}\" goes up to {}",
                                          cache->vertices(), name, target.sources - 1));
        }
        c.vertices = mesh.source_vertices;
      } else if (target.vertices == cache->vertices()) {
        c.first_vertex = first;
      } else {
        throw v.bad("file",
                    fmt::format("has {} vertices, but the mesh \"{}\" has {} in the scene. Exporters split vertices at "
                                "seams: export the mesh with an attribute _ORIGINAL_INDEX of its points, or write the "
                                "cache from the exported vertices",
                                cache->vertices(), name, target.vertices));
      }
      first += std::uint32_t(mesh.positions.size());
      if (mesh.cache.samples) throw v.bad("file", fmt::format("is the second cache of the mesh \"{}\"", name));
      distance += distance_to_rest(mesh, c, z_up ? kFromZUp : Affine3f{});
      other += distance_to_rest(mesh, c, z_up ? Affine3f{} : kFromZUp);
      bind_cache(mesh, std::move(c));
    }
    if (other < 0.01 * distance) {
      log_warning(fmt::format("the vertex cache {} fits the mesh \"{}\" much better with up = \"{}\"", file.string(),
                              name, z_up ? "y" : "z"));
    }
    // A cache counts as animation, unless the scene has one that is longer.
    const TimeSpan covered{cache->times().front(), cache->times().back()};
    if (covered.length() > 0) {
      TimeSpan& animation = scene.animation;
      const bool none = !(animation.length() > 0);
      animation =
          none ? covered : TimeSpan{std::min(animation.begin, covered.begin), std::max(animation.end, covered.end)};
    }
    std::string times;
    for (const double t : cache->times()) times += fmt::format("{},", t);
    edits += fmt::format("cache:{}.{:016x},{},{},{}:{};", name, cache->content_hash(), format,
                         v.params.get_string("up"), options.offset, times);
  }
  return edits;
}

}  // namespace tempera
