// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>

#include "tempera/core/vec.h"

namespace tempera {

inline constexpr int kCieSamples = 95;  ///< 360, 365, ..., 830 nm
struct CieSample {
  float x, y, z;
};
extern const std::array<CieSample, kCieSamples> kCieObserver;
extern const std::array<float, kCieSamples> kCieD65;  ///< relative power, 100 at 560 nm

struct ConductorEntry {
  const char* name;
  Rgb eta, k;
};
extern const std::array<ConductorEntry, 71> kConductors;  ///< sorted by name

}  // namespace tempera
