// SPDX-License-Identifier: Apache-2.0
#pragma once
// Following what pixels show from frame to frame; private to the module.
#include "tempera/frames/image.h"

namespace tempera {

/// Where `vectors` lead from position `from` (pixels): NaN if they are not valid there or leave the picture, or if
/// `back` (may be null), the vectors of the frame that they lead to, does not lead back.
/// Between pixels, vectors are interpolated, and valid where all four are.
Vec2f follow(const Vec2f& from, const Image& vectors, const Image* back);

inline bool is_position(const Vec2f& p) { return p.x == p.x; }

}  // namespace tempera
