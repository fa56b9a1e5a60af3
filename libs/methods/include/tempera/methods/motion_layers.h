// SPDX-License-Identifier: Apache-2.0
#pragma once
// Layers of motion, which are the same for all methods: of first surfaces, and of what chains show.
#include "tempera/methods/method.h"

namespace tempera {

/// Builds what they look at in the frames around: for Method::begin_pass, of the pass that writes them.
void prepare_motion_layers(const SceneWindow& window);
/// Writes those of the unit's tile that its picture has. Pre: prepared.
void write_motion_layers(const SceneWindow& window, const Unit& unit, UnitOutput& out);

}  // namespace tempera
