// SPDX-License-Identifier: Apache-2.0
#pragma once
// Runs the passes of a method on a section, unit by unit, on all threads.
#include <functional>
#include <stop_token>

#include "tempera/methods/section.h"

namespace tempera {

struct SectionHooks {
  /// What a pass reads of the frame `frame`, which lies before the section's.
  std::function<Image(int frame, const LayerRead& read)> read;
  /// Which pixels of a frame are wanted: [h,w,1] of the full picture, above 0 where they are. Null: all.
  std::function<const Image*(int frame)> mask;
  /// A unit is done; `picture` is null for one that has no pixels of its own. Called concurrently.
  std::function<void(const Unit& unit, const Frame* picture, const RenderTotals& totals)> done;
};

/// Renders the units of `part` that `section` lacks, up to the first pass that waits for units of other parts.
/// Result:  whether all of them are done: not if `stop` was requested.
/// Errors:  those of Method and SceneWindow. What is done stays in `section`.
/// Threads: uses parallel_for; `section` may be saved meanwhile.
bool render_section(const Method& method, SceneWindow& window, Section& section, const Part& part,
                    const SectionHooks& hooks, const std::stop_token& stop);

}  // namespace tempera
