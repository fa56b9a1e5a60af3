// SPDX-License-Identifier: Apache-2.0
#pragma once
// What a shot works out from the motion of its scene before anything is rendered: where it is cut, and how finely
// motion is resampled. Functions of the whole shot, never of the frames that are asked for.
#include <optional>
#include <vector>

#include "tempera/pipeline/shot.h"

namespace tempera {

/// Ends the flights of cameras, and of other nodes that jump, from one side of each cut to the other: exporters write a
/// cut as two keys a frame apart. The pose before a cut goes on as it moved. `declared`: first frames after cuts.
void cut_motion(Scene& scene, const FrameClock& clock, const std::vector<int>& declared);

/// First frames after cuts, in order: the declared ones, and those where the camera jumps from one view to another.
/// Warns where a camera flies from one view to another within a frame, as if a cut were meant.
std::vector<int> find_cuts(const Scene& scene, const RenderSettings& settings, const std::vector<int>& declared);

/// Segments of a frame between knots of the motion grid: `wanted`, or the least power of two from 4 up that leaves no
/// more than a quarter of a pixel between resampled and authored motion in any frame of the animation. Warns where more
/// than half a pixel is left.
int settle_motion_segments(const Scene& scene, const RenderSettings& settings, std::optional<int> wanted);

}  // namespace tempera
