// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/materials.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "tempera/core/color.h"

namespace tempera {

namespace {

std::optional<Rgb> parse_hex(std::string_view digits) {
  if (digits.size() != 6) return std::nullopt;
  std::uint32_t bits = 0;
  const auto [end, ec] = std::from_chars(digits.data(), digits.data() + 6, bits, 16);
  if (ec != std::errc() || end != digits.data() + 6) return std::nullopt;
  const auto channel = [&](int shift) { return srgb_to_linear(float((bits >> shift) & 255u) / 255.0f); };
  return Rgb{channel(16), channel(8), channel(0)};
}

}  // namespace

std::optional<Rgb> parse_color(std::string_view text) {
  if (text.starts_with('#')) return parse_hex(text.substr(1));
  std::vector<float> numbers;
  const char* at = text.data();
  const char* const end = text.data() + text.size();
  for (;;) {
    while (at != end && *at == ' ') ++at;
    float v = 0;
    const auto [next, ec] = std::from_chars(at, end, v);
    if (ec != std::errc() || !std::isfinite(v)) return std::nullopt;
    numbers.push_back(v);
    at = next;
    while (at != end && *at == ' ') ++at;
    if (at == end) break;
    if (*at++ != ',') return std::nullopt;
  }
  if (numbers.size() == 1) return Rgb(numbers[0]);
  if (numbers.size() == 3) return Rgb{numbers[0], numbers[1], numbers[2]};
  return std::nullopt;
}

SourceLoc MaterialValues::loc(const std::string& name) const {
  const auto it = locs_.find(name);
  return it == locs_.end() ? SourceLoc{} : it->second;
}

Rgb MaterialValues::checked(const std::string& name, const Rgb& c) const {
  if (std::min({c.r, c.g, c.b}) >= 0) return c;
  throw Error(ErrorCode::kOutOfRange, loc(name), fmt::format("{} = \"{}\" is below 0", name, params_.get_string(name)));
}

Rgb MaterialValues::color(const std::string& name) const {
  const std::string& text = params_.get_string(name);
  if (const auto c = parse_color(text)) return checked(name, *c);
  throw Error(ErrorCode::kBadInput, loc(name),
              fmt::format("{} = \"{}\" is not a color; write a number, three numbers or \"#rrggbb\"", name, text));
}

std::optional<bool> MaterialValues::two_sided() const {
  if (!locs_.contains("two_sided")) return std::nullopt;
  return params_.get_bool("two_sided");
}

Slot MaterialValues::slot(const std::string& name, bool is_color) const {
  const std::string& text = params_.get_string(name);
  if (const auto c = parse_color(text)) return Slot(checked(name, *c));
  // What has no extension cannot be meant as a file.
  if (text.find('.') == std::string::npos) {
    throw Error(ErrorCode::kBadInput, loc(name),
                fmt::format("{} = \"{}\" is neither a color (a number, three numbers or \"#rrggbb\") nor an image file",
                            name, text));
  }
  ImageTextureParams texture;
  texture.file = files_(text, loc(name));
  texture.flip_v = true;
  if (!is_color) {
    texture.encoding = ColorEncoding::kLinear;
    texture.channel = Channel::kR;
  }
  return Slot(make_image_texture(texture, loc(name)));
}
Slot MaterialValues::color_slot(const std::string& name) const { return slot(name, true); }
Slot MaterialValues::scalar_slot(const std::string& name) const { return slot(name, false); }

namespace {

ParamSpec roughness_param(const char* fallback = "0") {
  return {"roughness", fallback, "microfacet roughness alpha in [0,1], or an image; 0: smooth"};
}
ParamSpec distribution_param() {
  return {"distribution", "ggx", "microfacet distribution", -1e300, 1e300, {"ggx", "beckmann"}};
}
ParamSpec ior_param(double fallback) { return {"int_ior", fallback, "index of refraction inside", 1, 5}; }
ParamSpec outer_ior_param() { return {"ext_ior", 1.000277, "index of refraction outside", 1, 5}; }

Roughness roughness(const MaterialValues& v) {
  Roughness r;
  r.alpha_u = r.alpha_v = v.scalar_slot("roughness");
  r.rough = !r.alpha_u.is_constant() || r.alpha_u.mean().r > 0;
  r.distribution = v.params().get_string("distribution") == "ggx" ? Microfacets::kGgx : Microfacets::kBeckmann;
  return r;
}

MaterialPtr diffuse(const MaterialValues& v) { return make_diffuse(v.color_slot("reflectance")); }

MaterialPtr conductor(const MaterialValues& v) {
  ConductorParams p;
  p.eta = v.color_slot("eta");
  p.k = v.color_slot("k");
  p.specular_reflectance = v.color_slot("reflectance");
  p.roughness = roughness(v);
  return make_conductor(p);
}

MaterialPtr dielectric(const MaterialValues& v) {
  DielectricParams p;
  p.int_ior = float(v.params().get_double("int_ior"));
  p.ext_ior = float(v.params().get_double("ext_ior"));
  p.specular_reflectance = v.color_slot("reflectance");
  p.specular_transmittance = v.color_slot("transmittance");
  p.thin = v.params().get_bool("thin");
  p.roughness = roughness(v);
  if (p.thin && p.roughness.rough) {
    throw Error(ErrorCode::kBadInput, v.loc("roughness"), "a thin dielectric is smooth: roughness must be 0");
  }
  return make_dielectric(p);
}

MaterialPtr plastic(const MaterialValues& v) {
  PlasticParams p;
  p.int_ior = float(v.params().get_double("int_ior"));
  p.ext_ior = float(v.params().get_double("ext_ior"));
  p.diffuse_reflectance = v.color_slot("reflectance");
  p.specular_reflectance = v.color_slot("specular");
  p.nonlinear = v.params().get_bool("nonlinear");
  p.roughness = roughness(v);
  return make_plastic(p);
}

MaterialPtr principled(const MaterialValues& v) {
  PrincipledParams p;
  p.base_color = v.color_slot("base_color");
  p.roughness = v.scalar_slot("roughness");
  p.anisotropic = v.scalar_slot("anisotropic");
  p.metallic = v.scalar_slot("metallic");
  p.spec_trans = v.scalar_slot("spec_trans");
  p.spec_tint = v.scalar_slot("spec_tint");
  p.sheen = v.scalar_slot("sheen");
  p.sheen_tint = v.scalar_slot("sheen_tint");
  p.flatness = v.scalar_slot("flatness");
  p.clearcoat = v.scalar_slot("clearcoat");
  p.clearcoat_gloss = v.scalar_slot("clearcoat_gloss");
  p.eta = float(v.params().get_double("eta"));
  return make_principled(p);
}

MaterialPtr metallic_roughness(const MaterialValues& v) {
  MetallicRoughnessParams p;
  p.base_color = v.color_slot("base_color");
  p.metallic = v.scalar_slot("metallic");
  p.roughness = v.scalar_slot("roughness");
  p.transmission = v.scalar_slot("transmission");
  p.specular = v.scalar_slot("specular");
  p.specular_color = v.color_slot("specular_color");
  p.ior = float(v.params().get_double("ior"));
  p.clearcoat = v.scalar_slot("clearcoat");
  p.clearcoat_roughness = v.scalar_slot("clearcoat_roughness");
  p.sheen_color = v.color_slot("sheen_color");
  p.sheen_roughness = v.scalar_slot("sheen_roughness");
  p.thin_walled = v.params().get_bool("thin_walled");
  p.attenuation_color = v.color("attenuation_color");
  const double distance = v.params().get_double("attenuation_distance");
  p.attenuation_distance = distance > 0 ? float(distance) : kInfinity;
  p.tints_once = v.params().get_string("solid_tint") == "once";
  p.double_sided = v.two_sided().value_or(true);
  return make_metallic_roughness(p);
}

}  // namespace

std::span<const MaterialEntry> material_catalog() {
  static const std::vector<MaterialEntry> entries = {
      {"diffuse", "ideally diffuse reflection", {{"reflectance", "0.5", "color or image"}}, diffuse},
      {"conductor",
       "metal, smooth or rough",
       {{"eta", "0", "real part of the index of refraction: number or three"},
        {"k", "1", "imaginary part; eta 0 and k 1 reflect everything"},
        {"reflectance", "1", "factor of the reflection: color or image"},
        roughness_param(),
        distribution_param()},
       conductor},
      {"dielectric",
       "glass and other clear solids and liquids, smooth, thin or rough",
       {ior_param(1.5046),
        outer_ior_param(),
        {"reflectance", "1", "factor of the reflection: color or image"},
        {"transmittance", "1", "factor of the transmission: color or image"},
        {"thin", false, "two parallel interfaces without refraction between them, e.g. a pane"},
        roughness_param(),
        distribution_param()},
       dielectric},
      {"plastic",
       "diffuse base under a clear coat",
       {{"reflectance", "0.5", "of the base: color or image"},
        {"specular", "1", "factor of the coat's reflection: color or image"},
        {"nonlinear", false, "color shifts of the scattering inside"},
        ior_param(1.49),
        outer_ior_param(),
        roughness_param(),
        distribution_param()},
       plastic},
      {"principled",
       "Mitsuba's principled material",
       {{"base_color", "0.5", "color or image"},
        {"roughness", "0.5", "perceptual roughness in [0,1], or an image"},
        {"anisotropic", "0", "in [0,1]"},
        {"metallic", "0", "in [0,1], or an image"},
        {"spec_trans", "0", "specular transmission in [0,1]"},
        {"spec_tint", "0", "in [0,1]"},
        {"sheen", "0", "in [0,1]"},
        {"sheen_tint", "0", "in [0,1]"},
        {"flatness", "0", "in [0,1]"},
        {"clearcoat", "0", "in [0,1]"},
        {"clearcoat_gloss", "0", "in [0,1]"},
        {"eta", 1.5, "index of refraction relative to the outside", 1, 5}},
       principled},
      {"metallic_roughness",
       "glTF's material",
       {{"base_color", "1", "color or image"},
        {"metallic", "1", "in [0,1], or an image"},
        {"roughness", "1", "perceptual roughness in [0,1], or an image"},
        {"transmission", "0", "in [0,1], or an image"},
        {"specular", "1", "in [0,1], or an image"},
        {"specular_color", "1", "color or image"},
        {"ior", 1.5, "index of refraction", 1, 5},
        {"clearcoat", "0", "in [0,1], or an image"},
        {"clearcoat_roughness", "0", "in [0,1], or an image"},
        {"sheen_color", "0", "color or image"},
        {"sheen_roughness", "0", "in [0,1], or an image"},
        {"thin_walled", true, "false: a solid body that refracts"},
        {"solid_tint",
         "twice",
         "solid bodies: whether base_color tints light as it enters and again as it leaves, or once in all",
         -1e300,
         1e300,
         {"twice", "once"}},
        {"attenuation_color", "1", "color of white light after `attenuation_distance` inside"},
        {"attenuation_distance", 0.0, "meters; 0: no attenuation", 0, 1e9}},
       metallic_roughness},
  };
  return entries;
}

std::span<const ParamSpec> common_material_params() {
  static const std::vector<ParamSpec> params = {
      {"two_sided", false,
       "the back looks like the front (opaque types only) and shines like it; false: only the front does. If it is not "
       "given, emission is as in the scene, and metallic_roughness shows both sides"},
      {"opacity", "1", "part of the light that does not pass straight through: number or image"},
      {"emission", "", "radiance that the surface emits, W/(m^2 sr): color or image; empty: as in the scene"},
  };
  return params;
}

void override_material(Scene& scene, const std::string& name, const std::map<std::string, ParamValue>& values,
                       const std::map<std::string, SourceLoc>& locs, const FileResolver& files) {
  const SourceLoc first = locs.empty() ? SourceLoc{} : locs.begin()->second;
  std::vector<std::string> known;
  bool found = false;
  for (const Shape& s : scene.shapes) {
    found |= s.material_name == name;
    if (std::find(known.begin(), known.end(), s.material_name) == known.end()) known.push_back(s.material_name);
  }
  if (!found) {
    throw Error(ErrorCode::kUnknownName, first,
                fmt::format("the scene has no material \"{}\"; it has: {}", name, nearest_names(name, known)));
  }

  const auto type = values.find("type");
  std::vector<std::string> types;
  for (const MaterialEntry& e : material_catalog()) types.push_back(e.name);
  const std::span<const ParamSpec> common = common_material_params();
  const auto is_common = [&](const auto& value) {
    return std::any_of(common.begin(), common.end(), [&](const ParamSpec& s) { return s.name == value.first; });
  };
  const bool changes_type = !std::all_of(values.begin(), values.end(), is_common);
  if (changes_type && type == values.end()) {
    throw Error(ErrorCode::kBadInput, first,
                fmt::format("material \"{}\" needs a type; one of: {}", name, fmt::join(types, ", ")));
  }
  const std::span<const MaterialEntry> catalog = material_catalog();
  const auto entry = std::find_if(catalog.begin(), catalog.end(), [&](const MaterialEntry& e) {
    return changes_type && e.name == to_text(type->second);
  });
  if (changes_type && entry == catalog.end()) {
    throw Error(ErrorCode::kUnknownName, locs.at("type"),
                fmt::format("unknown material type \"{}\"; known: {}", to_text(type->second),
                            nearest_names(to_text(type->second), types)));
  }
  std::vector<ParamSpec> specs;
  if (changes_type) specs = entry->params;
  specs.insert(specs.end(), common.begin(), common.end());
  Params params(specs);
  for (const auto& [key, value] : values) {
    if (key != "type") params.set_text(key, to_text(value), locs.at(key));
  }
  const MaterialValues v(params, locs, files);
  const std::optional<bool> two_sided = v.two_sided();
  const Slot opacity = v.scalar_slot("opacity");
  const auto changed = [&](MaterialPtr material) {
    if (two_sided.value_or(false)) material = make_two_sided(material);
    if (!opacity.is_constant() || opacity.mean().r < 1) material = make_mask(opacity, material);
    return material;
  };
  const MaterialPtr made = changes_type ? changed(entry->make(v)) : nullptr;
  for (Shape& s : scene.shapes) {
    if (s.material_name != name) continue;
    s.material = made ? made : changed(s.material);
    if (!params.get_string("emission").empty()) {
      const Slot radiance = v.color_slot("emission");
      const bool both_sides = s.emission && s.emission->two_sided;
      s.emission = AreaEmission{radiance, both_sides};
      if (radiance.is_constant() && is_black(radiance.mean())) s.emission.reset();
    }
    if (s.emission && two_sided) s.emission->two_sided = *two_sided;
  }
}

}  // namespace tempera
