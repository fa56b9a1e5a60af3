// SPDX-License-Identifier: Apache-2.0
#include "tempera/shading/color_space.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstring>

#include "file_color_space.h"
#include "tempera/core/color.h"
#include "tempera/core/log.h"

namespace tempera {

namespace {

/// CIE xy of red, green, blue and white.
using Chromaticities = std::array<double, 8>;
constexpr Chromaticities kRec709{0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290};

struct Primaries {
  std::string_view name;
  Chromaticities xy;
};
constexpr std::array<Primaries, 6> kPrimaries{{
    {"rec709", kRec709},
    {"p3d65", {0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290}},
    {"rec2020", {0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290}},
    {"adobergb", {0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290}},
    {"ap1", {0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767}},
    {"ap0", {0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767}},
}};

/// XYZ of a color of luminance 1.
Vec3d xyz(double x, double y) { return {x / y, 1, (1 - x - y) / y}; }

/// Linear maps are affine ones without translation here.
Affine3d xyz_from_rgb(const Chromaticities& c) {
  const Affine3d primaries{{c[0], c[1], 1 - c[0] - c[1]}, {c[2], c[3], 1 - c[2] - c[3]}, {c[4], c[5], 1 - c[4] - c[5]}};
  const Vec3d scale = inverse(primaries).vector(xyz(c[6], c[7]));  // so that equal parts are white
  return {primaries.x * scale.x, primaries.y * scale.y, primaries.z * scale.z};
}

/// White of `from` becomes white of `to`: Bradford's cone responses are scaled.
Affine3d adaptation(const Vec3d& from, const Vec3d& to) {
  constexpr Affine3d kBradford{{0.8951, -0.7502, 0.0389}, {0.2664, 1.7135, -0.0685}, {-0.1614, 0.0367, 1.0296}};
  const Vec3d a = kBradford.vector(from), b = kBradford.vector(to);
  const Affine3d scale{{b.x / a.x, 0, 0}, {0, b.y / a.y, 0}, {0, 0, b.z / a.z}};
  return inverse(kBradford) * scale * kBradford;
}

void set_matrix(ColorSpace& space, const Affine3d& m) {
  const auto column = [](const Vec3d& v) { return Rgb{float(v.x), float(v.y), float(v.z)}; };
  space.rec709 = false;
  space.red = column(m.x), space.green = column(m.y), space.blue = column(m.z);
}

/// False for coordinates that span no colors.
bool set_primaries(ColorSpace& space, const Chromaticities& c) {
  space.rec709 = true;
  for (std::size_t i = 0; i < 8; ++i) space.rec709 = space.rec709 && std::abs(c[i] - kRec709[i]) < 1e-3;
  if (space.rec709) return true;
  const Affine3d m =
      inverse(xyz_from_rgb(kRec709)) * adaptation(xyz(c[6], c[7]), xyz(kRec709[6], kRec709[7])) * xyz_from_rgb(c);
  if (!is_finite(m.x) || !is_finite(m.y) || !is_finite(m.z)) {
    space.rec709 = true;
    return false;
  }
  set_matrix(space, m);
  return true;
}

float decode(const ColorSpace& s, float v) {
  const float a = std::abs(v);
  float r = a;
  switch (s.transfer) {
    case ColorSpace::Transfer::kLinear:
      break;
    case ColorSpace::Transfer::kSrgb:
      r = srgb_to_linear(a);
      break;
    case ColorSpace::Transfer::kRec709:  // [ITU-R BT.709, Item 1.2], inverted
      r = a < 0.081f ? a / 4.5f : std::pow((a + 0.099f) / 1.099f, 1 / 0.45f);
      break;
    case ColorSpace::Transfer::kGamma:
      r = std::pow(a, s.gamma);
      break;
  }
  return std::copysign(r, v);
}

bool set_transfer(ColorSpace& space, std::string_view name) {
  if (name == "lin" || name == "linear") {
    space.transfer = ColorSpace::Transfer::kLinear;
  } else if (name == "srgb" || name == "srgbe" || name == "srgbx") {
    space.transfer = ColorSpace::Transfer::kSrgb;
  } else if (name.size() == 3 && name[0] == 'g' && std::isdigit(name[1]) && std::isdigit(name[2])) {
    space.transfer = ColorSpace::Transfer::kGamma;
    space.gamma = float(name[1] - '0') + 0.1f * float(name[2] - '0');
  } else {
    return false;
  }
  return true;
}

std::string lower(std::string_view text) {
  std::string s(text);
  std::transform(s.begin(), s.end(), s.begin(), [](unsigned char c) { return char(std::tolower(c)); });
  return s;
}

/// What OpenImageIO calls color spaces.
std::optional<ColorSpace> oiio_color_space(const OIIO::ImageSpec& spec, const std::string& name, bool png) {
  ColorSpace space;
  if (name == "linear" || name == "scene_linear" || name == "lin_srgb" || name == "lin_rec709" || name == "raw")
    return space;
  if (name == "srgb" || name == "srgb_texture") {
    space.transfer = ColorSpace::Transfer::kSrgb;
  } else if (name == "rec709") {
    space.transfer = ColorSpace::Transfer::kRec709;
  } else if (name == "acescg") {
    return named_color_space("lin_ap1_scene");
  } else if (name == "adobergb") {
    return named_color_space("g22_adobergb_scene");
  } else if (name.starts_with("gamma")) {
    const float gamma = spec.get_float_attribute("oiio:Gamma", std::strtof(name.c_str() + 5, nullptr));
    if (!(gamma > 0.1f && gamma < 10)) return std::nullopt;
    // PNG's gAMA of 0.45455 is what encoders write for sRGB [PNG, 11.3.2.5].
    space.transfer = png && std::abs(gamma - 2.2f) < 0.01f ? ColorSpace::Transfer::kSrgb : ColorSpace::Transfer::kGamma;
    space.gamma = gamma;
  } else {
    return named_color_space(name);
  }
  return space;
}

}  // namespace

Rgb ColorSpace::to_linear(const Rgb& stored) const {
  const Rgb c{decode(*this, stored.r), decode(*this, stored.g), decode(*this, stored.b)};
  return rec709 ? c : red * c.r + green * c.g + blue * c.b;
}

std::optional<ColorSpace> named_color_space(std::string_view id) {
  if (id == "data") return ColorSpace{};
  const auto first = id.find('_'), second = id.find('_', first + 1);
  if (first == std::string_view::npos || second == std::string_view::npos) return std::nullopt;
  const std::string_view primaries = id.substr(first + 1, second - first - 1), reference = id.substr(second + 1);
  ColorSpace space;
  if (!set_transfer(space, id.substr(0, first)) || (reference != "scene" && reference != "display"))
    return std::nullopt;
  if (primaries == "ciexyzd65" || primaries == "xyzd65") {
    set_matrix(space, inverse(xyz_from_rgb(kRec709)));
    return space;
  }
  const auto* known =
      std::find_if(kPrimaries.begin(), kPrimaries.end(), [&](const Primaries& p) { return p.name == primaries; });
  if (known == kPrimaries.end()) return std::nullopt;
  set_primaries(space, known->xy);
  // [Adobe RGB (1998), 4.3.1.2] has 2 51/256.
  if (primaries == "adobergb" && space.transfer == ColorSpace::Transfer::kGamma && std::abs(space.gamma - 2.2f) < 1e-3f)
    space.gamma = 2.19921875f;
  return space;
}

ColorSpace color_space_of(const OIIO::ImageInput& input, const std::string& name) {
  const OIIO::ImageSpec& spec = input.spec();
  ColorSpace fallback;
  if (!spec.format.is_floating_point()) fallback.transfer = ColorSpace::Transfer::kSrgb;
  const char* assumed = fallback.is_srgb() ? "sRGB" : "linear Rec. 709";
  const auto unknown = [&](const std::string& what) {
    log_warning(fmt::format("{}: {} is not known; taken as {}", name, what, assumed));
    return fallback;
  };

  const std::string id = spec.get_string_attribute("colorInteropID");
  if (!id.empty() && id != "unknown") {
    const auto space = named_color_space(lower(id));
    return space ? *space : unknown(fmt::format("the color space \"{}\" (colorInteropID)", id));
  }
  if (const std::string icc = spec.get_string_attribute("ICCProfile:profile_description");
      !icc.empty() && lower(icc).find("srgb") == std::string::npos) {
    log_warning(fmt::format("{}: its color profile \"{}\" is ignored; taken as {}", name, icc, assumed));
  }
  if (OIIO::ParamValue stored; const auto* p = spec.find_attribute("chromaticities", stored)) {
    if (p->type().basetype == OIIO::TypeDesc::FLOAT && p->type().basevalues() == 8) {
      Chromaticities c;
      std::copy_n(static_cast<const float*>(p->data()), 8, c.begin());
      ColorSpace space = fallback;
      if (!set_primaries(space, c)) return unknown("the white of its chromaticities");
      return space;
    }
  }
  const std::string oiio = spec.get_string_attribute("oiio:ColorSpace");
  // Of PPM and PFM, which say nothing, it reports Rec. 709 all the same.
  if (oiio.empty() || oiio == "unknown" || std::strcmp(input.format_name(), "pnm") == 0) return fallback;
  const auto space = oiio_color_space(spec, lower(oiio), std::strcmp(input.format_name(), "png") == 0);
  return space ? *space : unknown(fmt::format("the color space \"{}\"", oiio));
}

ColorSpace file_color_space(const std::filesystem::path& file) {
  const auto input = OIIO::ImageInput::open(file.string());
  if (input) return color_space_of(*input, file.string());
  OIIO::geterror();
  return {};
}

}  // namespace tempera
