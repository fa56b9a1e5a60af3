// SPDX-License-Identifier: Apache-2.0
#pragma once
// Puts pixels that were rendered alone into the frames of a stage that asked for them by a mask. Plans of chains insert
// it (stage_plan.h): a stage says which pixels it cannot make, and never sees a scene.
#include "tempera/stages/stage.h"

namespace tempera {

/// Ports: the stage's frames, with their mask, and frames in which the pixels of the mask are rendered. Where the mask
/// is above 0, every layer that both have is taken from the latter, bit by bit; all else stays, and the mask goes.
extern const StageEntry fill_entry;

}  // namespace tempera
