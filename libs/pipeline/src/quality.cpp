// SPDX-License-Identifier: Apache-2.0
#include "quality.h"

#include <array>

namespace tempera {

const Quality* quality_of(const ShotConfig& config) {
  static const std::array<Quality, 3> known = {{{"draft", 8, {kDenoiser}, true},
                                                {"final", 64, {kDenoiser}, true},
                                                {"fast", 64, {kDenoiser, "upsample", "interpolate", "motionblur"}}}};
  for (const Quality& q : known) {
    if (q.name == config.get_string("quality")) return &q;
  }
  return nullptr;
}

}  // namespace tempera
