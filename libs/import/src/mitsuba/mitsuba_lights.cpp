// SPDX-License-Identifier: Apache-2.0
// Mitsuba's emitters.
#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <array>
#include <cmath>

#include "mitsuba_build.h"
#include "singular.h"
#include "sky/sunsky.h"
#include "tempera/shading/color_space.h"

namespace tempera::mitsuba {
namespace {

constexpr double kRadians = kPiD / 180;
constexpr int kSkyWidth = 2048;  // the sun is three pixels wide

/// Environment's local frame (y up) in that of Mitsuba's sky (z up): see sun_sky_image.
constexpr Affine3d kSkyFromEnvironment{{1, 0, 0}, {0, 0, 1}, {0, -1, 0}};

Affine3d facing(const Vec3d& origin, const Vec3d& direction) {
  return look_at(origin, origin + direction, Vec3d(Basis(Vec3f(normalize(direction))).s));
}

}  // namespace

AreaEmission Builder::area_emission(const Object& emitter) {
  AreaEmission emission;
  emission.radiance = slot(emitter, "radiance", 1.0f, SpectrumKind::kEmission);
  ignore(emitter, {"sampling_weight"});
  if (has(emitter, "to_world"))
    fail(ErrorCode::kBadInput, place(emitter, "to_world"),
         "an area emitter has the place of its shape; remove its to_world");
  finish(emitter);
  return emission;
}

void Builder::add_emitter(const Object& emitter) {
  static constexpr Named<void (Builder::*)(const Object&)> kPlugins[] = {{"area", &Builder::note_area_emitter},
                                                                         {"constant", &Builder::add_environment},
                                                                         {"envmap", &Builder::add_environment},
                                                                         {"sunsky", &Builder::add_sun_sky},
                                                                         {"sky", &Builder::add_sun_sky},
                                                                         {"sun", &Builder::add_sun_sky},
                                                                         {"point", &Builder::add_point},
                                                                         {"spot", &Builder::add_spot},
                                                                         {"directional", &Builder::add_directional},
                                                                         {"projector", &Builder::add_projector}};
  if (const auto* plugin = find_named(kPlugins, emitter.plugin)) return (this->*plugin->value)(emitter);
  ignore_all(emitter);
  warn(fmt::format("{} is left out", emitter.name()), emitter.place);
}

/// Area emitters that stand outside of shapes are there for shapes to refer to.
void Builder::note_area_emitter(const Object& emitter) {
  if (emitter.id.empty() || !document_.is_referenced(emitter.id))
    warn("an area emitter outside of a shape emits nothing", emitter.place);
}

bool Builder::in_place_of_to_world(const Object& emitter, std::string_view name) const {
  if (has(emitter, name) && has(emitter, "to_world"))
    fail(ErrorCode::kBadInput, place(emitter, name), fmt::format("\"{}\" and \"to_world\" exclude each other", name));
  return has(emitter, name);
}

void Builder::add_light(const Object& emitter, PunctualLight light, const Transform& to_world) {
  light.name = emitter.id.empty() ? fmt::format("{}_{}", emitter.plugin, scene_.lights.size()) : emitter.id;
  light.node = add_node(to_world, place(emitter, "to_world"), light.name);
  ignore(emitter, {"sampling_weight", "samples"});
  finish(emitter);
  scene_.lights.push_back(std::move(light));
}

void Builder::add_point(const Object& emitter) {
  PunctualLight light;
  light.type = LightType::kPoint;
  light.intensity = constant(emitter, "intensity", Rgb(1.0f), SpectrumKind::kEmission);
  Transform to_world = transform(emitter, "to_world");
  if (in_place_of_to_world(emitter, "position")) to_world.constant = translate(vector3(emitter, "position", {}));
  add_light(emitter, std::move(light), to_world);
}

void Builder::add_spot(const Object& emitter) {
  PunctualLight light;
  light.type = LightType::kSpot;
  light.intensity = constant(emitter, "intensity", Rgb(1.0f), SpectrumKind::kEmission);
  const double cutoff = number(emitter, "cutoff_angle", 20, 1e-3, 89.999);
  light.cutoff_angle = float(cutoff * kRadians);
  light.beam_width = float(number(emitter, "beam_width", cutoff * 0.75, 0, cutoff) * kRadians);
  const Slot image = slot(emitter, "texture", 1.0f);
  light.texture = image.texture;
  if (!image.texture) light.intensity = light.intensity.at(0) * image.factor.at(0);
  add_light(emitter, std::move(light), transform(emitter, "to_world"));
}

void Builder::add_directional(const Object& emitter) {
  PunctualLight light;
  light.type = LightType::kDirectional;
  light.intensity = constant(emitter, "irradiance", Rgb(1.0f), SpectrumKind::kEmission);
  Transform to_world = transform(emitter, "to_world");
  if (in_place_of_to_world(emitter, "direction")) {
    const Vec3d direction = vector3(emitter, "direction", {0, 0, 1});
    if (length(direction) == 0)
      fail(ErrorCode::kOutOfRange, place(emitter, "direction"), "the direction must not be zero");
    to_world.constant = facing({}, direction);
  }
  add_light(emitter, std::move(light), to_world);
}

void Builder::add_projector(const Object& emitter) {
  PunctualLight light;
  light.type = LightType::kProjector;
  const Object* image = named_child(emitter, "irradiance");
  const Slot irradiance = slot(emitter, "irradiance", 1.0f, SpectrumKind::kEmission);
  light.texture = irradiance.texture;
  // Mitsuba's irradiance is that which a white diffuse surface at distance 1 shows as radiance.
  light.intensity = irradiance.factor.at(0) * float(kPiD * number(emitter, "scale", 1, 0));
  double aspect = 1;
  if (image && image->plugin == "bitmap") {
    const auto size = image_size(file(*image, "filename"), place(*image, "filename"));
    aspect = double(size.x) / size.y;
  }
  light.projector_aspect = float(aspect);
  bool vertical = false;
  light.projector_fov = float(horizontal_fov(emitter, aspect, vertical));
  add_light(emitter, std::move(light), transform(emitter, "to_world"));
}

Vec2i Builder::image_size(const std::filesystem::path& path, const Place& at) const {
  const auto in = OIIO::ImageInput::open(path.string());
  if (!in)
    fail(ErrorCode::kBadInput, at, fmt::format("cannot read the image \"{}\": {}", path.string(), OIIO::geterror()));
  return {std::max(in->spec().width, 1), std::max(in->spec().height, 1)};
}

void Builder::add_environment(const Object& emitter) {
  ignore(emitter, {"sampling_weight", "samples"});
  Environment environment;
  environment.name = emitter.id.empty() ? emitter.plugin : emitter.id;
  if (emitter.plugin == "constant") {
    environment.radiance = constant(emitter, "radiance", Rgb(1.0f), SpectrumKind::kEmission);
    ignore(emitter, {"to_world"});
  } else {
    const std::filesystem::path path = file(emitter, "filename");
    const Place& at = place(emitter, "filename");
    files_.note(path, document_.loc(at));
    const auto in = OIIO::ImageInput::open(path.string());
    if (!in)
      fail(ErrorCode::kBadInput, at, fmt::format("cannot read the image \"{}\": {}", path.string(), OIIO::geterror()));
    const OIIO::ImageSpec& spec = in->spec();
    const std::uint64_t pixels = std::uint64_t(std::max(spec.width, 0)) * std::uint64_t(std::max(spec.height, 0));
    if (pixels == 0 || pixels > (std::uint64_t(1) << 28) || spec.nchannels < 1 || spec.nchannels > 64)
      fail(ErrorCode::kBadInput, at,
           fmt::format("an environment image of {} x {} pixels and {} channels cannot be used", spec.width, spec.height,
                       spec.nchannels));
    files_.charge(pixels * sizeof(Rgb), document_.loc(at));
    const int channels = std::min(spec.nchannels, 3);
    std::vector<float> data(pixels * channels);
    if (!in->read_image(0, 0, 0, channels, OIIO::TypeDesc::FLOAT, data.data()))
      fail(ErrorCode::kBadInput, at, fmt::format("cannot read the image \"{}\": {}", path.string(), in->geterror()));
    ColorSpace space = file_color_space(path);
    if (has(emitter, "gamma")) {
      const double gamma = number(emitter, "gamma", -1);
      if (gamma > 0) space = {gamma != 1 ? ColorSpace::Transfer::kSrgb : ColorSpace::Transfer::kLinear};
    }
    environment.width = spec.width;
    environment.height = spec.height;
    environment.image.resize(pixels);
    bool repaired = false;
    for (std::size_t i = 0; i < pixels; ++i) {
      Rgb stored;
      for (int c = 0; c < 3; ++c) {
        float v = data[i * channels + (channels >= 3 ? c : 0)];
        if (!(v >= 0) || !std::isfinite(v)) repaired = true, v = 0;
        stored[c] = v;
      }
      environment.image[i] = clamp(space.to_linear(stored), 0, kInfinity);
    }
    if (repaired) warn("pixels of an environment image that are negative, infinite or not a number are set to 0", at);
    environment.radiance = Rgb(float(number(emitter, "scale", 1, 0)));
    ignore(emitter, {"mis_compensation", "cache"});
    environment.node = add_node(rotation_only(transform(emitter, "to_world"), place(emitter, "to_world")),
                                place(emitter, "to_world"), environment.name);
  }
  finish(emitter);
  scene_.environments.push_back(std::move(environment));
}

Transform Builder::rotation_only(Transform t, const Place& at) const {
  const auto strip = [&](Affine3d& m) {
    const std::optional<Affine3d> whole = with_all_axes(m);
    if (!whole) fail(ErrorCode::kOutOfRange, at, "the transform of an environment must be invertible");
    m = *whole;
    m.translation = {};
    m.x = normalize(m.x), m.y = normalize(m.y), m.z = normalize(m.z);
  };
  strip(t.constant);
  for (auto& [time, m] : t.keys) strip(m);
  return t;
}

void Builder::add_sun_sky(const Object& emitter) {
  ignore(emitter, {"sampling_weight", "samples"});
  const bool legacy = document_.is_legacy(emitter.place);
  SunSkyParams params;
  params.turbidity = number(emitter, "turbidity", 3, 1, 10);
  params.albedo = constant(emitter, "albedo", Rgb(legacy ? 0.15f : 0.3f), SpectrumKind::kReflectance);
  params.sky_scale = number(emitter, "sky_scale", emitter.plugin == "sun" ? 0 : 1, 0);
  params.sun_scale = number(emitter, "sun_scale", emitter.plugin == "sky" ? 0 : 1, 0);
  if (has(emitter, "scale"))
    (emitter.plugin == "sun" ? params.sun_scale : params.sky_scale) *= number(emitter, "scale", 1, 0);
  params.sun_aperture =
      number(emitter, "sun_aperture", 0.5358, 1e-3, 179) * number(emitter, "sun_radius_scale", 1, 1e-3, 300);
  ignore(emitter, {"complex_sun", "resolution"});
  if (has(emitter, "stretch") && number(emitter, "stretch", 1) != 1)
    warn("\"stretch\" of a sky is ignored", place(emitter, "stretch"));
  if (boolean(emitter, "extend", false)) warn("\"extend\" of a sky is ignored", place(emitter, "extend"));

  // The model's z is up, and so is that of Mitsuba 3's sky; in 0.6 it is y.
  Transform to_world = rotation_only(transform(emitter, "to_world"), place(emitter, "to_world"));
  if (to_world.keys.size() > 1) warn("the transform of a sky keeps its first key", place(emitter, "to_world"));
  const Affine3d world_from_model = to_world.constant * (legacy ? inverse(kSkyFromEnvironment) : Affine3d{});
  static constexpr std::array<std::string_view, 9> kTimes{"latitude", "longitude", "timezone", "year",  "month",
                                                          "day",      "hour",      "minute",   "second"};
  if (has(emitter, "sun_direction")) {
    for (std::string_view name : kTimes)
      if (has(emitter, name))
        fail(ErrorCode::kBadInput, place(emitter, name),
             fmt::format("\"sun_direction\" and \"{}\" exclude each other", name));
    const Vec3d d = vector3(emitter, "sun_direction", {0, 0, 1});
    if (length(d) == 0) fail(ErrorCode::kOutOfRange, place(emitter, "sun_direction"), "the direction must not be zero");
    params.sun_direction = normalize(inverse(world_from_model).vector(d));
  } else {
    SunTime time;
    time.year = integer(emitter, "year", time.year, 1900, 2200);
    time.month = integer(emitter, "month", time.month, 1, 12);
    time.day = integer(emitter, "day", time.day, 1, 31);
    time.hour = number(emitter, "hour", time.hour, 0, 24);
    time.minute = number(emitter, "minute", time.minute, 0, 60);
    time.second = number(emitter, "second", time.second, 0, 60);
    time.latitude = number(emitter, "latitude", time.latitude, -90, 90);
    time.longitude = number(emitter, "longitude", time.longitude, -360, 360);
    time.timezone = number(emitter, "timezone", time.timezone, -24, 24);
    const SunAngles sun = sun_position(time);
    const double s = std::sin(sun.zenith);
    // North is -x in Mitsuba 3 and -z in 0.6; east is -y, and x.
    params.sun_direction = legacy ? Vec3d{s * std::sin(sun.azimuth), s * std::cos(sun.azimuth), std::cos(sun.zenith)}
                                  : Vec3d{-s * std::cos(sun.azimuth), -s * std::sin(sun.azimuth), std::cos(sun.zenith)};
  }
  if (params.sun_direction.z <= 0) warn("the sun stands below the horizon: the sky is black", emitter.place);

  Environment environment;
  environment.name = emitter.id.empty() ? emitter.plugin : emitter.id;
  environment.width = kSkyWidth;
  environment.height = kSkyWidth / 2;
  files_.charge(std::uint64_t(kSkyWidth) * (kSkyWidth / 2) * sizeof(Rgb), document_.loc(emitter.place));
  const Grid<Rgb> image = sun_sky_image(params, kSkyWidth);
  environment.image.assign(image.begin(), image.end());
  environment.node = add_node({world_from_model * kSkyFromEnvironment, {}}, emitter.place, environment.name);
  finish(emitter);
  scene_.environments.push_back(std::move(environment));
}

}  // namespace tempera::mitsuba
