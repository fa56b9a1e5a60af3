// SPDX-License-Identifier: Apache-2.0
#include "tempera/methods/motion_layers.h"

#include "tempera/transport/pixel_motion.h"
#ifdef TEMPERA_PATH_SPACE_MOTION
#include "tempera/chain_motion/chain_motion.h"
#endif

namespace tempera {

void prepare_motion_layers(const SceneWindow& window) {
  if (!window.settings().asks_for_chain_motion()) return;
  for (int f = window.section().first; f <= window.section().last; ++f) window.neighbourhood(f);
}

void write_motion_layers(const SceneWindow& window, const Unit& unit, UnitOutput& out) {
  write_motion(window.frame(unit.frame), unit.tile, out.picture());
#ifdef TEMPERA_PATH_SPACE_MOTION
  if (!window.settings().asks_for_chain_motion()) return;
  const auto wants = [&](int x, int y) { return out.wants(x, y); };
  write_chain_motion(window.frame(unit.frame), window.neighbourhood(unit.frame), unit.tile, wants, out.picture());
#endif
}

}  // namespace tempera
