// SPDX-License-Identifier: Apache-2.0
#pragma once
// Rigid and affine motion resampled to knots: translation, rotation and upper-triangular scale, interpolated exactly as
// Embree interpolates RTCQuaternionDecomposition.
#include <optional>
#include <span>
#include <vector>

#include "tempera/accel/motion_grid.h"
#include "tempera/core/vec.h"

namespace tempera {

constexpr std::int64_t kMaxSegments = 128;  // Embree: at most 129 time steps per geometry

/// m = translate(t) * rotate(q) * U with U upper triangular: x -> (scale.x x + skew_xy y + skew_xz z, ...).
struct AffineKnot {
  Quatf q;
  Vec3f scale{1, 1, 1};
  Vec3f skew;  ///< xy, xz, yz
  Vec3f translation;
  bool operator==(const AffineKnot&) const = default;
};

/// Decomposes any affine map (QR). Rotations that differ by half turns about the axes, with scales of other signs, are
/// decompositions of one map: this takes the one that `near` comes to by the motion that is most likely. Scales keep
/// their signs; one or all change theirs if the map is mirrored against `near`, and two if the alternative is nearly
/// half a turn. `near` also fills in what a singular map leaves open; without it mirrored maps get a negative scale.z.
AffineKnot decompose(const Affine3d& m, const AffineKnot* near = nullptr);
/// Consecutive maps of one motion, decomposed so that their interpolation takes the short way everywhere: a scale
/// passes through zero where it changes its sign, and maps that are singular turn with their neighbours.
std::vector<AffineKnot> decompose(std::span<const Affine3d> motion);
Affine3f compose(const AffineKnot& k);
/// U of a knot.
Affine3f upper(const AffineKnot& k);
/// Between knots: linear in scale, skew and translation, slerp in rotation.
Affine3f interpolate(const AffineKnot& a, const AffineKnot& b, float s);
/// The same interpolation in double, and its derivative with respect to s.
struct MovingAffine {
  Affine3d map, rate;
};
MovingAffine interpolate_moving(const AffineKnot& a, const AffineKnot& b, double s);

/// Whether rays can be taken into the space of such maps and of all between them: finite, far from singular, and no
/// scale changes its sign.
bool is_invertible(std::span<const AffineKnot> knots);
/// Whether none of the maps leaves any surface.
bool vanishes(std::span<const AffineKnot> knots);
/// The map itself, or one beside it that can be inverted: flattened things get a thickness of a millionth.
Affine3d make_invertible(const Affine3d& m);

}  // namespace tempera
