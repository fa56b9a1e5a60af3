// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/settings.h"

#include <fmt/format.h>

namespace tempera {

std::string RenderSettings::canonical() const {
  std::string s = fmt::format(
      "size={}x{} crop={},{},{},{} camera={} fps={} first={} start={} shutter={},{},{},{},{},{} spp={} seed={},{} "
      "sampler={} filter={},{} layers={} decomposition={} cryptomatte={}",
      width, height, crop_x, crop_y, crop_width, crop_height, camera, clock.fps, clock.first, clock.start,
      clock.shutter.open, clock.shutter.close, int(clock.shutter.shape), clock.shutter.ramp_in, clock.shutter.ramp_out,
      clock.shutter.rolling, spp, seed, seed_per_frame, int(sampler), filter_name(filter.kind()), filter.radius(),
      fmt::join(layers, ","), classes_are_decomposition, cryptomatte_depth);
  for (const float c : clock.shutter.curve) s += fmt::format(" {}", c);
  for (const PathClass& c : classes) s += fmt::format(" {}={}", c.name, c.expression);
  if (!cuts.empty()) s += fmt::format(" cuts={}", fmt::join(cuts, ","));
  return s;
}

}  // namespace tempera
