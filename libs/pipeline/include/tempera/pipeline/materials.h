// SPDX-License-Identifier: Apache-2.0
#pragma once
// Materials by name and parameters: what shot.toml's [materials.<name>] tables replace a scene's materials with. The
// table of types feeds the parser, `tempera list bsdfs` and the manual.
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/core/params.h"
#include "tempera/scene/scene.h"
#include "tempera/shading/material.h"

namespace tempera {

/// Where a texture file that is called `name` at `loc` lies.
using FileResolver = std::function<std::filesystem::path(const std::string& name, const SourceLoc& loc)>;

/// Values of a material's table, still as text, with their places.
class MaterialValues {
 public:
  MaterialValues(const Params& params, std::map<std::string, SourceLoc> locs, FileResolver files)
      : params_(params), locs_(std::move(locs)), files_(std::move(files)) {}
  /// A constant ("0.5", "0.8,0.1,0.1", "#cc3300" in sRGB) or an image file. Errors: Error{kBadInput | kMissingFile} at
  /// it, Error{kOutOfRange} below 0.
  Slot color_slot(const std::string& name) const;
  /// The same for what is no color: the first channel of an image is taken as stored.
  Slot scalar_slot(const std::string& name) const;
  /// A constant only. Errors: Error{kBadInput | kOutOfRange}.
  Rgb color(const std::string& name) const;
  const Params& params() const { return params_; }
  /// The parameter two_sided, if it was given.
  std::optional<bool> two_sided() const;
  SourceLoc loc(const std::string& name) const;

 private:
  Slot slot(const std::string& name, bool is_color) const;
  Rgb checked(const std::string& name, const Rgb& c) const;
  const Params& params_;
  std::map<std::string, SourceLoc> locs_;
  FileResolver files_;
};

/// One type of material.
struct MaterialEntry {
  std::string name;
  std::string help;
  std::vector<ParamSpec> params;
  MaterialPtr (*make)(const MaterialValues& values);
};
/// All of them, in the order of the manual.
std::span<const MaterialEntry> material_catalog();
/// Parameters that every type has besides its own: opacity, two_sided, emission.
std::span<const ParamSpec> common_material_params();

/// Replaces the material of all shapes whose material is called `name`. `values` are the parameters, `locs` where each
/// stands. Without a `type` they may only be common ones, and change the scene's own material.
/// Errors: Error{kUnknownName} for a material that the scene lacks, a type or a parameter; those of make.
void override_material(Scene& scene, const std::string& name, const std::map<std::string, ParamValue>& values,
                       const std::map<std::string, SourceLoc>& locs, const FileResolver& files);

/// "0.5", "0.8,0.1,0.1" or "#rrggbb" (sRGB) as linear RGB; none for other text.
std::optional<Rgb> parse_color(std::string_view text);

}  // namespace tempera
