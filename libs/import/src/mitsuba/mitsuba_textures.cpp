// SPDX-License-Identifier: Apache-2.0
// Spectra and textures of Mitsuba scenes as slots of our materials.
#include <fmt/format.h>

#include <cmath>

#include "mitsuba_build.h"
#include "tempera/shading/spectrum.h"

namespace tempera::mitsuba {
namespace {

Rgb rgb_of(const Vec3d& v) { return {float(v.x), float(v.y), float(v.z)}; }

}  // namespace

Rgb Builder::color(const Property& property, SpectrumKind kind) const {
  const auto checked = [&](const Rgb& c) {
    if (kind == SpectrumKind::kReflectance && (c.r < 0 || c.g < 0 || c.b < 0 || max_component(c) > 1 + 1e-4f))
      warn("a reflectance outside [0, 1] is clamped", property.place);
    if (kind != SpectrumKind::kReflectance && (c.r < 0 || c.g < 0 || c.b < 0))
      warn("a negative spectrum is clamped to 0", property.place);
    return clamp(c, 0.0f, kind == SpectrumKind::kReflectance ? 1.0f : kInfinity);
  };
  if (const auto* v = std::get_if<double>(&property.value)) return checked(Rgb(float(*v)));
  if (const auto* v = std::get_if<std::int64_t>(&property.value)) return checked(Rgb(float(*v)));
  if (const auto* v = std::get_if<Color>(&property.value)) return checked(rgb_of(v->rgb));
  if (const auto* v = std::get_if<Blackbody>(&property.value)) {
    if (v->temperature <= 0)
      fail(ErrorCode::kOutOfRange, property.place,
           fmt::format("a temperature of {} K must be positive", v->temperature));
    return blackbody_rgb(float(v->temperature)) * float(v->scale);
  }
  if (const auto* v = std::get_if<Spectrum>(&property.value)) {
    if (v->wavelengths.empty()) {
      // Mitsuba 3 emits the equal-energy white, which is pinkish against the D65 white of our color space; 0.6 in its
      // RGB build emits plain white.
      const bool equal_energy = kind == SpectrumKind::kEmission && !document_.is_legacy(property.place);
      return checked((equal_energy ? xyz_to_rgb(Rgb(1.0f)) : Rgb(1.0f)) * float(v->values[0]));
    }
    const std::vector<float> wavelengths(v->wavelengths.begin(), v->wavelengths.end());
    const std::vector<float> values(v->values.begin(), v->values.end());
    const Rgb c = spectrum_to_rgb(wavelengths, values, kind == SpectrumKind::kEmission);
    // Saturated spectra lie outside our gamut: clamping them is what Mitsuba does, too, and no reason for a warning.
    return clamp(c, 0.0f, kind == SpectrumKind::kReflectance ? 1.0f : kInfinity);
  }
  wrong_type(property, "a number, color or spectrum");
}

Slot Builder::slot(const Object& object, std::string_view name, Slot fallback, SpectrumKind kind) {
  const Property* p = find(object, name);
  if (!p) return fallback;
  if (std::holds_alternative<ObjectPtr>(p->value) || std::holds_alternative<Reference>(p->value)) {
    const Object& nested = document_.resolve(*p);
    if (nested.tag != "texture" && nested.tag != "spectrum")
      fail(ErrorCode::kBadInput, p->place,
           fmt::format("\"{}\" is a {}; expected a texture or spectrum", name, nested.tag));
    return texture_slot(nested, kind);
  }
  return color(*p, kind);
}

Rgb Builder::constant(const Object& object, std::string_view name, const Rgb& fallback, SpectrumKind kind) {
  const Slot s = slot(object, name, fallback, kind);
  if (s.texture) {
    warn(fmt::format("a texture as \"{}\" of {} is replaced by its mean", name, object.name()), place(object, name));
    return s.mean();
  }
  return s.factor.at(0);
}

UvTransform Builder::uv_transform(const Object& texture) const {
  const Transform t = transform(texture, "to_uv");
  if (!t.keys.empty()) warn("an animated to_uv keeps its first key", place(texture, "to_uv"));
  const Affine3d& m = t.constant;
  UvTransform uv{float(m.x.x), float(m.y.x), float(m.translation.x),
                 float(m.x.y), float(m.y.y), float(m.translation.y)};
  // 0.6: uv -> scale * uv + offset
  const double u_scale = number(texture, "uscale", 1), v_scale = number(texture, "vscale", 1);
  const double u_offset = number(texture, "uoffset", 0), v_offset = number(texture, "voffset", 0);
  uv = {uv.a * float(u_scale), uv.b * float(u_scale), uv.c * float(u_scale) + float(u_offset),
        uv.d * float(v_scale), uv.e * float(v_scale), uv.f * float(v_scale) + float(v_offset)};
  return uv;
}

Slot Builder::bitmap_texture(const Object& texture, SpectrumKind kind) {
  ImageTextureParams params;
  params.file = file(texture, "filename");
  files_.note(params.file, document_.loc(place(texture, "filename")));
  params.transform = uv_transform(texture);

  static constexpr Named<TextureFilter> kFilters[] = {{"bilinear", TextureFilter::kBilinear},
                                                      {"nearest", TextureFilter::kNearest},
                                                      {"trilinear", TextureFilter::kMipmap},
                                                      {"ewa", TextureFilter::kMipmap}};
  params.filter = choice(texture, "filter_type", "bilinear", kFilters).value;
  ignore(texture, {"max_anisotropy", "cache", "format", "accel"});  // how, not what

  static constexpr Named<Wrap> kWraps[] = {
      {"repeat", Wrap::kRepeat}, {"mirror", Wrap::kMirror}, {"clamp", Wrap::kClamp}, {"zero", Wrap::kBlack},
      {"black", Wrap::kBlack},   {"one", Wrap::kClamp},     {"white", Wrap::kClamp}};
  const std::string_view both = choice(texture, "wrap_mode", "repeat", kWraps).name;
  const auto wrap = [&](std::string_view name) {
    const Named<Wrap>& mode = choice(texture, name, both, kWraps);
    if (mode.value == Wrap::kClamp && mode.name != "clamp")
      warn(fmt::format("texture wrap mode \"{}\" is treated as clamp", mode.name), place(texture, name));
    return mode.value;
  };
  params.wrap_u = wrap("wrap_mode_u");
  params.wrap_v = wrap("wrap_mode_v");

  params.encoding = boolean(texture, "raw", false) ? ColorEncoding::kLinear : ColorEncoding::kAuto;
  if (has(texture, "gamma")) {  // 0.6: -1 means "as the file says"
    const double gamma = number(texture, "gamma", -1);
    if (gamma == 1)
      params.encoding = ColorEncoding::kLinear;
    else if (gamma > 0) {
      params.encoding = ColorEncoding::kSrgb;
      if (std::abs(gamma - 2.2) > 0.01)
        warn(fmt::format("texture gamma {} is treated as the sRGB curve", gamma), place(texture, "gamma"));
    }
  }
  const bool one_number = kind == SpectrumKind::kScalar || kind == SpectrumKind::kHeight;
  const Named<Channel> channels[] = {{"", one_number ? Channel::kLuminance : Channel::kRgb},
                                     {"r", Channel::kR},
                                     {"g", Channel::kG},
                                     {"b", Channel::kB},
                                     {"a", Channel::kA},
                                     {"x", Channel::kR},
                                     {"y", Channel::kG},
                                     {"z", Channel::kB}};
  params.channel = choice(texture, "channel", "", channels).value;
  params.keep_negative = kind == SpectrumKind::kHeight;
  params.warnings = &warnings_;
  return make_image_texture(params, document_.loc(place(texture, "filename")));
}

Slot Builder::texture_slot(const Object& texture, SpectrumKind kind) {
  if (!in_construction_.insert(&texture).second)
    fail(ErrorCode::kBadInput, texture.place, fmt::format("{} refers to itself", texture.name()));
  const Slot result = make_texture_slot(texture, kind);
  in_construction_.erase(&texture);
  finish(texture);
  return result;
}

Slot Builder::checkerboard_texture(const Object& texture, SpectrumKind kind) {
  ignore(texture, {"line_width"});
  return make_checkerboard(slot(texture, "color0", 0.4f, kind), slot(texture, "color1", 0.2f, kind),
                           uv_transform(texture));
}

/// Of Mitsuba 0.6: a nested texture times a number or color.
Slot Builder::scale_texture(const Object& texture, SpectrumKind kind) {
  const Slot scale = slot(texture, "scale", 1.0f, SpectrumKind::kUnbounded);
  for (const Object* nested : children(texture, "texture")) {
    const Slot inner = texture_slot(*nested, kind);
    return Slot(scale.factor.at(0) * inner.factor.at(0), inner.texture);
  }
  for (const Property& p : texture.properties)  // or a constant under any name
    if (!p.used && !p.name.empty() && p.name != "scale")
      return scale.factor.at(0) * slot(texture, p.name, 1.0f, kind).factor.at(0);
  fail(ErrorCode::kBadInput, texture.place, "the scale texture has nothing to scale; nest a texture in it");
}

Slot Builder::vertex_color_texture(const Object& texture, SpectrumKind) {
  const std::string name = text(texture, "name", "vertex_color");
  const float scale = float(number(texture, "scale", 1));
  if (name == "vertex_color" || name == "face_color") return make_vertex_color(scale);
  warn(fmt::format("mesh attribute \"{}\" is replaced by white; only vertex_color and face_color are read", name),
       texture.place);
  return Rgb(scale);
}

// --- spectra as objects ---

Slot Builder::uniform_spectrum(const Object& texture, SpectrumKind kind) {
  ignore(texture, {"wavelength_min", "wavelength_max"});
  if (const Property* p = find(texture, "value")) {
    if (const auto* v = std::get_if<Vec3d>(&p->value)) return rgb_of(*v);
    if (texture.plugin == "uniform" && kind == SpectrumKind::kEmission)
      return xyz_to_rgb(Rgb(1.0f)) * float(number(texture, "value", 1));
    return color(*p, kind);
  }
  fail(ErrorCode::kBadInput, texture.place, fmt::format("{} needs a \"value\"", texture.name()));
}

Slot Builder::srgb_spectrum(const Object& texture, SpectrumKind kind) {
  ignore(texture, {"unbounded"});
  if (const Property* p = find(texture, "color")) return color(*p, kind);
  fail(ErrorCode::kBadInput, texture.place, fmt::format("{} needs a \"color\"", texture.name()));
}

Slot Builder::daylight_spectrum(const Object& texture, SpectrumKind) {
  const float scale = float(number(texture, "scale", 1));
  for (const Object* nested : children(texture, "texture")) {
    Slot inner = texture_slot(*nested, SpectrumKind::kUnbounded);
    return Slot(inner.factor.at(0) * scale, inner.texture);
  }
  return slot(texture, "color", 1.0f, SpectrumKind::kUnbounded).factor.at(0) * scale;
}

Slot Builder::blackbody_spectrum(const Object& texture, SpectrumKind) {
  ignore(texture, {"wavelength_min", "wavelength_max"});
  if (!has(texture, "temperature"))
    fail(ErrorCode::kBadInput, texture.place, "a blackbody needs a \"temperature\" in kelvin");
  return blackbody_rgb(float(number(texture, "temperature", 0, 1, 1e6))) * float(number(texture, "scale", 1));
}

Slot Builder::sampled_spectrum(const Object& texture, SpectrumKind kind) {
  if (const Property* p = find(texture, "value")) return color(*p, kind);
  Property sampled{"value", Spectrum{}, texture.place};
  auto& s = std::get<Spectrum>(sampled.value);
  if (!parse_numbers(text(texture, "values", ""), s.values) || s.values.size() < 2)
    fail(ErrorCode::kBadInput, place(texture, "values"), "\"values\" needs at least two numbers");
  if (texture.plugin == "regular") {
    const double lo = number(texture, "wavelength_min", 360, 1), hi = number(texture, "wavelength_max", 830, lo + 1e-3);
    for (std::size_t i = 0; i < s.values.size(); ++i)
      s.wavelengths.push_back(lo + (hi - lo) * double(i) / double(s.values.size() - 1));
  } else if (!parse_numbers(text(texture, "wavelengths", ""), s.wavelengths) ||
             s.wavelengths.size() != s.values.size()) {
    fail(ErrorCode::kBadInput, place(texture, "wavelengths"),
         fmt::format("\"wavelengths\" needs as many numbers as \"values\", which has {}", s.values.size()));
  }
  for (std::size_t i = 1; i < s.wavelengths.size(); ++i)
    if (s.wavelengths[i] <= s.wavelengths[i - 1])
      fail(ErrorCode::kBadInput, place(texture, "wavelengths"), "wavelengths must increase");
  return color(sampled, kind);
}

Slot Builder::make_texture_slot(const Object& texture, SpectrumKind kind) {
  static constexpr Named<Slot (Builder::*)(const Object&, SpectrumKind)> kPlugins[] = {
      {"bitmap", &Builder::bitmap_texture},
      {"checkerboard", &Builder::checkerboard_texture},
      {"scale", &Builder::scale_texture},
      {"mesh_attribute", &Builder::vertex_color_texture},
      {"vertexcolors", &Builder::vertex_color_texture},
      {"uniform", &Builder::uniform_spectrum},
      {"rawconstant", &Builder::uniform_spectrum},
      {"srgb", &Builder::srgb_spectrum},
      {"d65", &Builder::daylight_spectrum},
      {"blackbody", &Builder::blackbody_spectrum},
      {"regular", &Builder::sampled_spectrum},
      {"irregular", &Builder::sampled_spectrum},
  };
  if (const auto* plugin = find_named(kPlugins, texture.plugin)) return (this->*plugin->value)(texture, kind);
  const Rgb substitute = kind == SpectrumKind::kReflectance ? Rgb(0.5f) : Rgb(1.0f);
  warn_replaced(texture, fmt::format("a constant {}", substitute.r));
  ignore_all(texture);  // one message is enough
  return substitute;
}

}  // namespace tempera::mitsuba
