// SPDX-License-Identifier: Apache-2.0
// Mitsuba's sensors, films, samplers and integrators.
#include <fmt/format.h>

#include <cmath>

#include "mitsuba_build.h"
#include "singular.h"

namespace tempera::mitsuba {
namespace {

constexpr double kRadians = kPiD / 180;

}  // namespace

double Builder::horizontal_fov(const Object& object, double aspect, bool& vertical) const {
  enum class Axis { kX, kY, kDiagonal };
  const bool wide = aspect > 1;
  const Named<Axis> axes[] = {{"x", Axis::kX},
                              {"y", Axis::kY},
                              {"diagonal", Axis::kDiagonal},
                              {"smaller", wide ? Axis::kY : Axis::kX},
                              {"larger", wide ? Axis::kX : Axis::kY}};
  if (has(object, "fov") && has(object, "focal_length"))
    fail(ErrorCode::kBadInput, place(object, "focal_length"), "\"fov\" and \"focal_length\" exclude each other");
  double angle;
  Axis axis = choice(object, "fov_axis", "x", axes).value;
  if (has(object, "fov")) {
    angle = number(object, "fov", 45, 1e-6, 179.999999) * kRadians;
  } else {  // of a 35 mm camera: the diagonal of a 36 x 24 mm picture
    std::string length = "50mm";
    if (const Property* p = find(object, "focal_length"))
      length = std::holds_alternative<std::string>(p->value) ? std::get<std::string>(p->value)
                                                             : fmt::format("{}mm", number(object, "focal_length", 50));
    if (length.ends_with("mm")) length.resize(length.size() - 2);
    std::vector<double> mm;
    if (!parse_numbers(length, mm) || mm.size() != 1 || mm[0] <= 0)
      fail(ErrorCode::kBadInput, place(object, "focal_length"),
           fmt::format("\"{}\" is no focal length; expected e.g. 50mm", length));
    angle = 2 * std::atan(std::sqrt(36.0 * 36 + 24 * 24) / (2 * mm[0]));
    axis = Axis::kDiagonal;
  }
  vertical = axis == Axis::kY;
  if (vertical) return 2 * std::atan(std::tan(angle / 2) * aspect);
  if (axis == Axis::kDiagonal) return 2 * std::atan(std::tan(angle / 2) / std::sqrt(1 + 1 / (aspect * aspect)));
  return angle;
}

void Builder::add_sensor(const Object& sensor) {
  const std::string& plugin = sensor.plugin;
  const bool perspective = plugin == "perspective" || plugin == "thinlens" || plugin == "perspective_rdist";
  if (!perspective && plugin != "orthographic") {
    ignore_all(sensor);
    return warn(fmt::format("{} is left out", sensor.name()), sensor.place);
  }
  const Object* film = child(sensor, "film");
  const int width = film ? integer(*film, "width", 768, 1, 1 << 20) : 768;
  const int height = film ? integer(*film, "height", 576, 1, 1 << 20) : 576;

  Camera camera;
  camera.name = sensor.id.empty() ? fmt::format("camera_{}", scene_.cameras.size()) : sensor.id;
  camera.authored_aspect = float(width) / float(height);
  camera.near_clip = float(number(sensor, "near_clip", 1e-2, 1e-30));
  camera.far_clip = float(number(sensor, "far_clip", 1e4, 1e-30));
  if (camera.near_clip >= camera.far_clip)
    fail(ErrorCode::kOutOfRange, place(sensor, has(sensor, "near_clip") ? "near_clip" : "far_clip"),
         "near_clip must be smaller than far_clip");

  // A camera's frame is rigid, apart from mirror images; the scale of an orthographic one is the size of its picture.
  Transform to_world = transform(sensor, "to_world");
  const auto rigid = [&](Affine3d& m) {
    const std::optional<Affine3d> whole = with_all_axes(m);
    if (!whole) fail(ErrorCode::kOutOfRange, place(sensor, "to_world"), "the transform of a sensor must be invertible");
    const Vec3d s{length(m.x), length(m.y), length(m.z)};
    m = *whole;
    if (perspective && std::max({std::abs(s.x - s.y), std::abs(s.y - s.z), std::abs(s.z - s.x)}) > 1e-3 * s.x)
      warn("the scale in a perspective sensor's transform is dropped", place(sensor, "to_world"));
    if (!perspective && !(s.x > 0))
      fail(ErrorCode::kOutOfRange, place(sensor, "to_world"),
           "an orthographic sensor needs a scale in x: its picture's width");
    m.x = normalize(m.x), m.y = normalize(m.y), m.z = normalize(m.z);
    return s;
  };
  Vec3d size = rigid(to_world.constant);
  std::vector<double> times;
  std::vector<float> widths;
  for (std::size_t i = 0; i < to_world.keys.size(); ++i) {
    const Vec3d s = rigid(to_world.keys[i].second);
    if (i == 0) size = s;
    times.push_back(to_world.keys[i].first);
    widths.push_back(float(2 * s.x));
  }
  if (perspective) {
    camera.projection = Projection::kPerspective;
    camera.fov_x = float(horizontal_fov(sensor, double(width) / height, camera.keep_vertical_fov));
    // Mitsuba moves the camera's axis in the picture, we the picture against the axis.
    camera.principal_offset = {-float(number(sensor, "principal_point_offset_x", 0)),
                               -float(number(sensor, "principal_point_offset_y", 0))};
  } else {
    camera.projection = Projection::kOrthographic;
    if (std::abs(size.x - size.y) > 1e-4 * size.x)
      warn("an orthographic sensor whose scale differs in x and y keeps that of x", place(sensor, "to_world"));
    camera.width =
        times.size() > 1 ? Animated<float>(times, widths, Interpolation::kLinear) : Animated<float>(float(2 * size.x));
  }
  camera.focus_distance = float(number(sensor, "focus_distance", camera.far_clip, 1e-30));
  if (plugin == "thinlens") {
    if (!has(sensor, "aperture_radius"))
      fail(ErrorCode::kBadInput, sensor.place, "thinlens needs an \"aperture_radius\"");
    camera.aperture_radius = float(number(sensor, "aperture_radius", 0, 0));
  }
  camera.node = add_node(to_world, place(sensor, "to_world"), camera.name);

  const double open = number(sensor, "shutter_open", 0), close = number(sensor, "shutter_close", open);
  if (close < open)
    fail(ErrorCode::kOutOfRange, place(sensor, "shutter_close"), "shutter_close must not come before shutter_open");
  const bool first = scene_.cameras.empty();  // the others' films and samplers count only when they are asked for
  if (first && (has(sensor, "shutter_open") || has(sensor, "shutter_close")))
    scene_.defaults.exposure = TimeSpan{open, close};
  if (film) film_defaults(*film, width, height, first);
  if (const Object* sampler = child(sensor, "sampler")) {
    const int count = integer(*sampler, "sample_count", 4, 1, 1 << 30);
    if (first) scene_.defaults.spp = count;
    ignore_all(*sampler);  // how samples are drawn is ours to choose
  }
  for (const Object* medium : children(sensor, "medium")) warn("the medium around a sensor is ignored", medium->place);
  finish(sensor);
  scene_.cameras.push_back(std::move(camera));
}

void Builder::film_defaults(const Object& film, int width, int height, bool first) {
  RenderDefaults unused, &defaults = first ? scene_.defaults : unused;
  defaults.width = width;
  defaults.height = height;
  if (has(film, "crop_width") || has(film, "crop_height") || has(film, "crop_offset_x") || has(film, "crop_offset_y")) {
    defaults.crop_x = integer(film, "crop_offset_x", 0, 0, width - 1);
    defaults.crop_y = integer(film, "crop_offset_y", 0, 0, height - 1);
    defaults.crop_width = integer(film, "crop_width", width - defaults.crop_x, 1, width - defaults.crop_x);
    defaults.crop_height = integer(film, "crop_height", height - defaults.crop_y, 1, height - defaults.crop_y);
  }
  defaults.filter = "gaussian";
  defaults.filter_radius = 2;
  if (const Object* filter = child(film, "rfilter")) {
    const std::string& name = filter->plugin;
    if (name == "box") {
      defaults.filter = "box";
      defaults.filter_radius = number(*filter, "radius", 0.5, 0.5, 32);
    } else if (name == "tent") {
      defaults.filter = "tent";
      defaults.filter_radius = number(*filter, "radius", 1, 0.5, 32);
    } else if (name == "gaussian") {  // cut off at four standard deviations
      defaults.filter_radius = 4 * number(*filter, "stddev", 0.5, 0.01, 8);
    } else if (name == "mitchell" || name == "catmullrom" || name == "lanczos") {
      defaults.filter = "mitchell";
      defaults.filter_radius = 2;
      const double b = number(*filter, "B", 1.0 / 3), c = number(*filter, "C", 1.0 / 3);
      if (name != "mitchell" || std::abs(b - 1.0 / 3) > 1e-3 || std::abs(c - 1.0 / 3) > 1e-3)
        warn_replaced(*filter, "the mitchell filter with B = C = 1/3");
      ignore(*filter, {"lobes"});
    } else {
      warn_replaced(*filter, "the gaussian filter");
      ignore_all(*filter);
    }
    finish(*filter);
  }
  // Formats of files are the render command's business.
  ignore(film, {"pixel_format", "component_format", "file_format", "banner", "compensate", "high_quality_edges",
                "sample_border", "attach_log", "gamma", "tonemap_method", "exposure", "key", "burn", "digits",
                "variable", "label", "channel_names"});
  finish(film);
}

void Builder::add_integrator(const Object& integrator) {
  const std::string& plugin = integrator.plugin;
  RenderDefaults& defaults = scene_.defaults;
  defaults.integrator = "path";
  // What others write beside the picture are layers, which the render command asks for.
  ignore(integrator, {"block_size", "samples_per_pass", "timeout", "strict_normals", "aovs"});
  if (plugin == "moment" || plugin == "aov" || plugin == "adaptive" || plugin == "multichannel" ||
      plugin == "irrcache") {
    for (const Object* nested : children(integrator, "integrator")) add_integrator(*nested);
    if (plugin != "moment" && plugin != "aov" && plugin != "multichannel")
      warn_replaced(integrator, "what it contains");
    ignore_all(integrator);
    return;
  }
  defaults.hide_emitters = boolean(integrator, "hide_emitters", false);
  defaults.max_depth = integer(integrator, "max_depth", -1, -1, 1 << 30);
  defaults.rr_depth = integer(integrator, "rr_depth", 5, 1, 1 << 30);
  if (plugin == "direct") {
    defaults.max_depth = 2;
    ignore(integrator, {"shading_samples", "emitter_samples", "bsdf_samples"});
  } else if (plugin.starts_with("volpath")) {
    defaults.null_counts_as_bounce = false;
  } else if (plugin != "path" && plugin != "ptracer") {
    warn_replaced(integrator, "path");
    ignore_all(integrator);
  }
  finish(integrator);
}

}  // namespace tempera::mitsuba
