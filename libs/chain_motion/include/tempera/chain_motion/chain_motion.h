// SPDX-License-Identifier: Apache-2.0
#pragma once
// Motion of what mirrors and glass show: for each pixel and chain of specular events one path through its center and the
// center of the lens, in the middle of the exposure, and where the same matter is seen by the same events one frame later
// and before. [Zimmer 2015, Sec. 4]
#include <array>
#include <functional>

#include "tempera/frames/frame.h"
#include "tempera/manifold/specular_walk.h"
#include "tempera/transport/frame_context.h"
#include "tempera/transport/scene_timeline.h"

namespace tempera {

/// Counts over the walks of pixels.
struct ChainMotionCounts {
  WalkCounts steps;
  std::array<std::uint64_t, kMotionStates> states{};  ///< of forward and backward vectors, by MotionState
};

/// Writes the layers of a tile that `out` has of layers::chain_motion(). `neighbourhood`: what is there in between, see
/// SceneWindow. `wants(x, y)`: which pixels. Threads: re-entrant for different tiles.
void write_chain_motion(const FrameContext& context, const SceneTimeline& neighbourhood, const Tile& tile,
                        const std::function<bool(int x, int y)>& wants, Frame& out,
                        ChainMotionCounts* counts = nullptr);

}  // namespace tempera
