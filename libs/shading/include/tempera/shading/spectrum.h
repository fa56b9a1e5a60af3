// SPDX-License-Identifier: Apache-2.0
#pragma once
// From what scene files say about spectra (samples, names of metals and glasses, temperatures) to linear RGB, as
// Mitsuba's rgb variants convert it.
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/core/vec.h"

namespace tempera {

/// Linear RGB of a spectrum given by `values` at increasing `wavelengths` (nm), linear between them and zero outside;
/// by the CIE 1931 observer over 360 to 830 nm, normalised so that the constant 1 has luminance 1. Not clamped:
/// saturated spectra have negative components. `emission`: integrated as it is (an equal-energy spectrum is slightly
/// reddish); otherwise as a reflector under D65, where a constant is itself. Errors: Error{kBadInput} if sizes differ,
/// are zero, wavelengths do not increase or a number is not finite.
Rgb spectrum_to_rgb(std::span<const float> wavelengths, std::span<const float> values, bool emission);

/// Linear RGB of the radiance of a black body at `kelvin` (> 0), in W/(m^2 sr nm) as spectrum_to_rgb weighs it.
Rgb blackbody_rgb(float kelvin);

/// Linear RGB of CIE 1931 tristimulus values X, Y, Z (in r, g, b).
Rgb xyz_to_rgb(const Rgb& xyz);

struct ConductorIndices {
  Rgb eta, k;
};
/// Complex index of a named conductor ("Au", "Cu", "Al", ...); empty if unknown. Mitsuba's "none", a perfect mirror, is
/// eta 0, k 1.
std::optional<ConductorIndices> named_conductor(std::string_view name);
std::vector<std::string> named_conductors();

/// Index of refraction of a named dielectric ("air", "water", "bk7", "diamond", ...; case does not matter), at 589 nm;
/// empty if unknown.
std::optional<float> named_ior(std::string_view name);
std::vector<std::string> named_iors();

}  // namespace tempera
