// SPDX-License-Identifier: Apache-2.0
#include "tempera/shading/spectrum.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>

#include "spectral_tables.h"
#include "tempera/core/error.h"

namespace tempera {
namespace {

constexpr double kCieMin = 360, kCieMax = 830;
constexpr double kObserverIntegral = 106.7502593994140625;  // of the luminous efficiency, nm
constexpr double kD65Mean = 98.99741751876255;              // D65 weighted by the luminous efficiency

struct Named {
  const char* name;
  float ior;
};
// At 0 to 20 degrees Celsius and about 589 nm [Hecht 2002, "Optics"].
constexpr std::array<Named, 23> kIors{{
    {"vacuum", 1.0f},      {"helium", 1.000036f},        {"hydrogen", 1.000132f},
    {"air", 1.000277f},    {"carbon dioxide", 1.00045f}, {"water", 1.3330f},
    {"acetone", 1.36f},    {"ethanol", 1.361f},          {"carbon tetrachloride", 1.461f},
    {"glycerol", 1.4729f}, {"benzene", 1.501f},          {"silicone oil", 1.52045f},
    {"bromine", 1.661f},   {"water ice", 1.31f},         {"fused quartz", 1.458f},
    {"pyrex", 1.470f},     {"acrylic glass", 1.49f},     {"polypropylene", 1.49f},
    {"bk7", 1.5046f},      {"sodium chloride", 1.544f},  {"amber", 1.55f},
    {"pet", 1.5750f},      {"diamond", 2.419f},
}};

constexpr int kSteps = 1000;
/// RGB of value(wavelength), optionally under D65. A sum over 1000 points from end to end weighs each with 1/1000 of
/// the range, as Mitsuba does: 0.1 % less than the integral.
template <class F>
Rgb integrate(F&& value, bool d65) {
  double xyz[3] = {};
  for (int i = 0; i < kSteps; ++i) {
    const double w = kCieMin + (kCieMax - kCieMin) * i / (kSteps - 1);
    const double at = (w - kCieMin) / (kCieMax - kCieMin) * (kCieSamples - 1);
    const std::size_t k = std::min(int(at), kCieSamples - 2);
    const double s = at - double(k);
    const auto between = [&](double a, double b) { return a + s * (b - a); };
    double v = value(w);
    if (d65) v *= between(kCieD65[k], kCieD65[k + 1]) / kD65Mean;
    xyz[0] += v * between(kCieObserver[k].x, kCieObserver[k + 1].x);
    xyz[1] += v * between(kCieObserver[k].y, kCieObserver[k + 1].y);
    xyz[2] += v * between(kCieObserver[k].z, kCieObserver[k + 1].z);
  }
  const double scale = (kCieMax - kCieMin) / (kObserverIntegral * kSteps);
  return xyz_to_rgb({float(xyz[0] * scale), float(xyz[1] * scale), float(xyz[2] * scale)});
}

}  // namespace

Rgb xyz_to_rgb(const Rgb& xyz) {
  const auto [x, y, z] = xyz;
  return {3.240479f * x - 1.537150f * y - 0.498535f * z, -0.969256f * x + 1.875991f * y + 0.041556f * z,
          0.055648f * x - 0.204043f * y + 1.057311f * z};
}

Rgb spectrum_to_rgb(std::span<const float> wavelengths, std::span<const float> values, bool emission) {
  if (wavelengths.empty() || wavelengths.size() != values.size())
    throw Error(ErrorCode::kBadInput, "a spectrum needs as many wavelengths as values, and at least one");
  for (std::size_t i = 0; i < values.size(); ++i)
    if (!std::isfinite(values[i]) || !std::isfinite(wavelengths[i]) || (i > 0 && wavelengths[i] <= wavelengths[i - 1]))
      throw Error(ErrorCode::kBadInput, "a spectrum needs finite values at increasing wavelengths");
  if (std::all_of(values.begin(), values.end(), [&](float v) { return v == values[0]; }))
    return emission ? values[0] * xyz_to_rgb(Rgb(1.0f)) : Rgb(values[0]);
  std::size_t i = 0;
  return integrate(
      [&](double w) {
        if (w < wavelengths.front() || w > wavelengths.back()) return 0.0;
        while (i + 2 < wavelengths.size() && wavelengths[i + 1] <= w) ++i;
        const double s = (w - wavelengths[i]) / (double(wavelengths[i + 1]) - wavelengths[i]);
        return values[i] + s * (double(values[i + 1]) - values[i]);
      },
      !emission);
}

Rgb blackbody_rgb(float kelvin) {
  constexpr double c = 2.99792458e8, h = 6.62607015e-34, k = 1.380649e-23;  // SI, exact by definition
  const Rgb rgb = integrate(
      [&](double nm) {
        const double w = nm * 1e-9;
        return 1e-9 * 2 * h * c * c / (w * w * w * w * w * std::expm1(h * c / (w * k * double(kelvin))));
      },
      false);
  return clamp(rgb * (float(kSteps) / (kSteps - 1)), 0, kInfinity);  // below 1000 K red leaves the gamut
}

std::optional<ConductorIndices> named_conductor(std::string_view name) {
  for (const ConductorEntry& e : kConductors)
    if (name == e.name) return ConductorIndices{e.eta, e.k};
  return std::nullopt;
}

std::vector<std::string> named_conductors() {
  std::vector<std::string> names;
  for (const ConductorEntry& e : kConductors) names.push_back(e.name);
  return names;
}

std::optional<float> named_ior(std::string_view name) {
  std::string lower(name);
  for (char& ch : lower) ch = char(std::tolower(static_cast<unsigned char>(ch)));
  for (const Named& n : kIors)
    if (lower == n.name) return n.ior;
  return std::nullopt;
}

std::vector<std::string> named_iors() {
  std::vector<std::string> names;
  for (const Named& n : kIors) names.push_back(n.name);
  return names;
}

}  // namespace tempera
