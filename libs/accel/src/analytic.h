// SPDX-License-Identifier: Apache-2.0
#pragma once
// Analytic shapes in their unit space: sphere x^2+y^2+z^2 = 1, disk z = 0 with x^2+y^2 <= 1, cylinder x^2+y^2 = 1 with
// z in [0,1]. Parameters u, v are Mitsuba's.
#include <optional>

#include "tempera/core/vec.h"
#include "tempera/scene/geometry.h"

namespace tempera::analytic {

enum class Kind { kSphere, kDisk, kCylinder };

struct UnitHit {
  double t = 0;
  float u = 0, v = 0;
};

/// First intersection with tmin < t < tmax of o + t d, or nothing. Solved in double: callers hold float rays.
std::optional<UnitHit> intersect(Kind kind, const Vec3d& o, const Vec3d& d, double tmin, double tmax);

/// Where the line o + t d crosses the whole plane, sphere or infinite cylinder that the shape lies on, nearest to t =
/// `near`, with t, u and v exact to double rounding; or nothing.
struct LineHit {
  double t = 0, u = 0, v = 0;
};
std::optional<LineHit> cross_line(Kind kind, const Vec3d& o, const Vec3d& d, double near);

/// Position, outward unit normal and derivatives at (u, v), all in unit space. Near the poles of the sphere (and the
/// center of the disk) the derivatives with respect to the angle vanish.
template <class T>
struct UnitPoint {
  Vec3<T> p, n, dpdu, dpdv, dndu, dndv;
};
UnitPoint<double> evaluate(Kind kind, double u, double v);
UnitPoint<float> evaluate(Kind kind, float u, float v);

/// Box around the unit shape.
Bounds3f unit_bounds(Kind kind);
/// Box around the shape that `map` makes of the unit shape: the smallest, to rounding.
Bounds3f bounds(Kind kind, const Affine3d& map);
/// Area of the unit shape.
float unit_area(Kind kind);
/// Uniform point by area: unit-space position from u in [0,1)^2.
Vec3f sample(Kind kind, const Vec2f& u);

}  // namespace tempera::analytic
