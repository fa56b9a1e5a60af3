// SPDX-License-Identifier: Apache-2.0
#pragma once
// Which values of files are pictures. Private to the stages.
#include <cmath>

namespace tempera {

/// Beyond it values count as damaged: stages square differences of what they divide by reflectances.
inline constexpr float kLargestValue = 1e14f;
inline bool is_sound(float v) { return std::abs(v) <= kLargestValue; }
/// The value, or 0 for one that is damaged.
inline float sound(float v) { return is_sound(v) ? v : 0.0f; }

}  // namespace tempera
