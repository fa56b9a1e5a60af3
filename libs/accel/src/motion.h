// SPDX-License-Identifier: Apache-2.0
#pragma once
// Rigid and affine motion resampled to knots: translation, rotation and upper-triangular scale, interpolated exactly as
// Embree interpolates RTCQuaternionDecomposition.
#include <vector>

#include "tempera/core/time.h"
#include "tempera/scene/scene.h"

namespace tempera {

/// The motion grid: knot k stands at k * step seconds.
struct MotionGrid {
  double step = 1;
  struct Position {
    std::int64_t knot = 0;  ///< the knot at or before the time
    float blend = 0;        ///< in [0,1): towards the next knot
  };
  Position locate(double t) const {
    const double x = t / step, k = std::floor(x + 1e-9);  // a time that is meant to be a knot is that knot
    return {std::int64_t(k), float(std::clamp(x - k, 0.0, 1.0))};
  }
  double time(std::int64_t knot) const { return double(knot) * step; }
  std::int64_t first(TimeSpan span) const { return std::int64_t(std::floor(span.begin / step + 1e-9)); }
  std::int64_t last(TimeSpan span) const { return std::int64_t(std::ceil(span.end / step - 1e-9)); }
};

/// m = translate(t) * rotate(q) * U with U upper triangular: x -> (scale.x x + skew_xy y + skew_xz z, ...).
struct AffineKnot {
  Quatf q;
  Vec3f scale{1, 1, 1};
  Vec3f skew;  ///< xy, xz, yz
  Vec3f translation;
};

/// Decomposes any affine map (QR); mirrored maps get a negative scale.z, singular ones a tiny scale instead of 0.
AffineKnot decompose(const Affine3d& m);
Affine3f compose(const AffineKnot& k);
/// Between knots: linear in scale, skew and translation, slerp in rotation.
Affine3f interpolate(const AffineKnot& a, const AffineKnot& b, float s);
/// Its derivative with respect to s.
Affine3f interpolate_derivative(const AffineKnot& a, const AffineKnot& b, float s);

}  // namespace tempera
