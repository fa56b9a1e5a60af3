// SPDX-License-Identifier: Apache-2.0
#pragma once
// The sRGB transfer curve (IEC 61966-2-1). Values outside [0,1] follow the same formulas.
#include <cmath>

namespace tempera {

inline float linear_to_srgb(float v) { return v <= 0.0031308f ? 12.92f * v : 1.055f * std::pow(v, 1 / 2.4f) - 0.055f; }
inline float srgb_to_linear(float v) { return v <= 0.04045f ? v / 12.92f : std::pow((v + 0.055f) / 1.055f, 2.4f); }

}  // namespace tempera
