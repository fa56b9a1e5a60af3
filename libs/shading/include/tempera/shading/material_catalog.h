// SPDX-License-Identifier: Apache-2.0
#pragma once
// Materials by name and parameters, for whatever kind of file names them: shot.toml's [materials.<name>] tables, and
// scene files. The table of types also feeds `tempera list bsdfs` and the manual.
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/core/params.h"
#include "tempera/shading/material.h"

namespace tempera {

/// The parameters of a material as a file gives them, each else as its ParamSpec says.
class MaterialValues {
 public:
  virtual ~MaterialValues() = default;
  /// A color or an image. Errors: Error{kBadInput | kMissingFile}; Error{kOutOfRange} below 0.
  virtual Slot color_slot(const std::string& name) const = 0;
  /// The same for what is no color: of an image the first channel as it is stored.
  virtual Slot scalar_slot(const std::string& name) const = 0;
  /// A color. Errors: as color_slot.
  virtual Rgb color(const std::string& name) const = 0;
  /// Those that are neither: numbers, switches, choices.
  virtual const Params& params() const = 0;
  /// Whether the back is to look like the front, if the file says so.
  virtual std::optional<bool> two_sided() const { return std::nullopt; }
  virtual SourceLoc loc(const std::string& /*name*/) const { return {}; }
};

/// One type of material.
struct MaterialEntry {
  std::string name;
  std::string help;
  std::vector<ParamSpec> params;  ///< text without choices: a color or an image, as parse_color reads it
  MaterialPtr (*make)(const MaterialValues& values);
};
/// All of them, in the order of the manual.
std::span<const MaterialEntry* const> material_catalog();
/// The type of that name; null if there is none.
const MaterialEntry* find_material(std::string_view name);

/// "0.5", "0.8,0.1,0.1" or "#rrggbb" (sRGB) as linear RGB; none for other text.
std::optional<Rgb> parse_color(std::string_view text);

}  // namespace tempera
