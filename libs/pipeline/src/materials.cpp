// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/materials.h"

#include <fmt/format.h>

#include <algorithm>

namespace tempera {

namespace {

/// Values of a table, still as text, with their places.
class TableValues final : public MaterialValues {
 public:
  TableValues(const Params& params, const std::map<std::string, SourceLoc>& locs, const FileResolver& files)
      : params_(params), locs_(locs), files_(files) {}
  Slot color_slot(const std::string& name) const override { return slot(name, true); }
  Slot scalar_slot(const std::string& name) const override { return slot(name, false); }
  Rgb color(const std::string& name) const override;
  const Params& params() const override { return params_; }
  std::optional<bool> two_sided() const override {
    if (!locs_.contains("two_sided")) return std::nullopt;
    return params_.get_bool("two_sided");
  }
  SourceLoc loc(const std::string& name) const override {
    const auto it = locs_.find(name);
    return it == locs_.end() ? SourceLoc{} : it->second;
  }

 private:
  Slot slot(const std::string& name, bool is_color) const;
  Rgb checked(const std::string& name, const Rgb& c) const;
  const Params& params_;
  const std::map<std::string, SourceLoc>& locs_;
  const FileResolver& files_;
};

Rgb TableValues::checked(const std::string& name, const Rgb& c) const {
  if (std::min({c.r, c.g, c.b}) >= 0) return c;
  throw Error(ErrorCode::kOutOfRange, loc(name), fmt::format("{} = \"{}\" is below 0", name, params_.get_string(name)));
}

Rgb TableValues::color(const std::string& name) const {
  const std::string& text = params_.get_string(name);
  if (const auto c = parse_color(text)) return checked(name, *c);
  throw Error(ErrorCode::kBadInput, loc(name),
              fmt::format("{} = \"{}\" is not a color; write a number, three numbers or \"#rrggbb\"", name, text));
}

Slot TableValues::slot(const std::string& name, bool is_color) const {
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

}  // namespace

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
  for (const MaterialEntry* e : material_catalog()) types.push_back(e->name);
  const std::span<const ParamSpec> common = common_material_params();
  const auto is_common = [&](const auto& value) {
    return std::any_of(common.begin(), common.end(), [&](const ParamSpec& s) { return s.name == value.first; });
  };
  const bool changes_type = !std::all_of(values.begin(), values.end(), is_common);
  if (changes_type && type == values.end()) {
    throw Error(ErrorCode::kBadInput, first,
                fmt::format("material \"{}\" needs a type; one of: {}", name, fmt::join(types, ", ")));
  }
  const MaterialEntry* entry = changes_type ? find_material(to_text(type->second)) : nullptr;
  if (changes_type && !entry) {
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
  const TableValues v(params, locs, files);
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
