// SPDX-License-Identifier: Apache-2.0
#pragma once
// Where what a pixel shows is seen in the neighbouring frames: motion layers, and the map along which random numbers
// are replayed.
#include <optional>
#include <vector>

#include "tempera/frames/frame.h"
#include "tempera/transport/frame_context.h"

namespace tempera {

/// What stands at a pixel's center in the middle of the exposure (of its scan line).
struct PixelView {
  CameraRay ray;
  double time = 0;
  std::optional<SurfacePoint> point;  ///< none: the background
  float distance = kInfinity;         ///< along the ray
};
PixelView view_pixel(const FrameContext& context, int x, int y);

/// Where that is seen `step` frames later, minus where it is now; `depth` along the view axis. Finite. None where a
/// camera cannot see it.
struct PixelMotion {
  Vec2f pixels;
  float depth = 0;
};
std::optional<PixelMotion> pixel_motion(const FrameContext& context, const PixelView& view, int step);

/// Writes object_id, motion.forward and motion.backward, where `out` has them.
void write_motion(const FrameContext& context, const Tile& tile, Frame& out);

/// For each pixel of the crop window of a frame, row by row: the pixel of the frame before that shows the same matter.
/// One to one; depends on geometry alone. [Manzi 2016, Sec. 4.2.1]
struct ReplayMap {
  struct Source {
    int x = -1, y = -1;  ///< -1: none
    /// Motion is rounded to whole pixels; this is what that leaves over, in pixels within [-0.5, 0.5].
    Vec2f residue;
  };
  int x0 = 0, y0 = 0, width = 0, height = 0;
  std::vector<Source> sources;
  const Source& at(int x, int y) const {
    return sources[std::size_t(y - y0) * std::size_t(width) + std::size_t(x - x0)];
  }
};
/// `before` is the context of the preceding frame; its rays need only serve the middle of the exposure. Threads: uses
/// parallel_for.
ReplayMap make_replay_map(const FrameContext& before, const FrameContext& now);

}  // namespace tempera
