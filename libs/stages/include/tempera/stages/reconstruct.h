// SPDX-License-Identifier: Apache-2.0
#pragma once
// How the stage `reconstruct` cuts a sequence into windows, which are solved one after the other (poisson.h) and
// blended.
#include <vector>

#include "tempera/core/time.h"

namespace tempera {

/// The windows that frames [segment.first, segment.last] without a cut are solved in. Window k covers the frames
/// [k step, k step + length) with step = length - overlap, whatever the segment's start: where a part of a sequence is
/// reconstructed apart, its windows are those of the whole. Windows are clipped to the segment, and those that another
/// one contains are left out. Pre: 0 <= overlap < length.
std::vector<FrameRange> reconstruction_windows(const FrameRange& segment, int length, int overlap);

/// Weight of frame `frame` in the window of length `length` that covers it and begins at `begin` before clipping.
/// Source: [Manzi 2016, Sec. 5], a Hann window, to be divided by the sum over windows. In (0, 1].
double window_weight(int frame, int begin, int length);

}  // namespace tempera
