// SPDX-License-Identifier: Apache-2.0
#pragma once
// Maps that flatten what they place: files hide objects by a scale of 0.
#include <array>
#include <optional>

#include "tempera/core/vec.h"

namespace tempera {

/// Whether `m` leaves no volume, as far as its numbers can tell.
bool is_singular(const Affine3d& m);

/// `m` if it is regular. A map onto a plane gets a thickness of 1e-4 of its size across it, so that the two sides of a
/// closed surface stay apart and inverses exist; where the plane is, and what lies in it, does not change. Nothing for
/// a map onto a line or a point. Axes shorter than 1e-30 count as 0.
std::optional<Affine3d> with_thickness(const Affine3d& m);

/// `m` with one axis of length 0 put across the other two, right-handed, for frames that are to be made rigid. Nothing
/// if that leaves it singular.
std::optional<Affine3d> with_all_axes(Affine3d m);

/// A rotation whose axes are those of `m`, made orthogonal, as far as those have a length and differ. What is left open
/// follows `hint`. Axes of a mirrored map are turned around first, so that the rotation is right-handed.
Quatd closest_rotation(const Affine3d& m, bool mirrored, const Quatd& hint);

}  // namespace tempera
