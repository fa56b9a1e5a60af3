// SPDX-License-Identifier: Apache-2.0
#pragma once
// Walks on the manifold of paths through mirrors and glass from one time to another: the path between two ends that move,
// through matter that moves. [Jakob 2012, Sec. 4.2; Zimmer 2015, Sec. 4]
#include <optional>

#include "tempera/manifold/specular_walk.h"

namespace tempera {

/// Where the first bend of `chain` (without any: its last end) will be after `dt` seconds, if its ends move as they do now
/// and its surfaces as they are at `ends` then: to first order. Empty at a fold.
std::optional<Vec3d> predict(const ChainMatter& matter, const ChainEnds& ends, const SpecularChain& chain, double dt);

/// Follows `chain` to time `to`, before or after its own, while its ends move. `tolerance`: see walk_in_space.
WalkState walk_in_time(const ChainMatter& matter, const ChainEnds& ends, double to, double tolerance,
                       SpecularChain& chain, WalkCounts* counts = nullptr);

}  // namespace tempera
