// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the numbers of an image file mean as colors, and the way from them to linear Rec. 709, in which rendering works.
#include <filesystem>
#include <optional>
#include <string_view>

#include "tempera/core/vec.h"

namespace tempera {

struct ColorSpace {
  enum class Transfer { kLinear, kSrgb, kRec709, kGamma };
  Transfer transfer = Transfer::kLinear;
  float gamma = 1;     ///< kGamma: linear = stored^gamma
  bool rec709 = true;  ///< red, green, blue and white are those of Rec. 709; else the next three lead there
  Rgb red{1, 0, 0}, green{0, 1, 0}, blue{0, 0, 1};

  bool is_linear() const { return transfer == Transfer::kLinear && rec709; }
  bool is_srgb() const { return transfer == Transfer::kSrgb && rec709; }
  /// Linear Rec. 709 of stored numbers. Negative ones stand for the mirrored curve.
  Rgb to_linear(const Rgb& stored) const;
};

/// A color space by its identifier of the Color Interop Forum, e.g. "lin_rec709_scene", "srgb_rec709_scene",
/// "lin_ap1_scene", "g22_adobergb_scene", or "data": encodings lin, srgb, g18, g22, g24, g26; primaries rec709, p3d65,
/// rec2020, ap0, ap1, adobergb, ciexyzd65, for scene or display. Empty for others.
std::optional<ColorSpace> named_color_space(std::string_view id);

/// The color space that a picture's file states: the attribute colorInteropID, else EXR's chromaticities and what
/// OpenImageIO reports (of PNG: sRGB and gAMA). Where the file says nothing, integers are sRGB and floats linear; where
/// it says what is not known, too, with a warning. Files that cannot be read are linear.
ColorSpace file_color_space(const std::filesystem::path& file);

}  // namespace tempera
