// SPDX-License-Identifier: Apache-2.0
#pragma once
// Analytic shapes in their unit space: sphere x^2+y^2+z^2 = 1, disk z = 0 with x^2+y^2 <= 1 facing +z, open cylinder
// x^2+y^2 = 1 with z in [0,1]. Parameters u, v are Mitsuba's: sphere phi/2pi, theta/pi; disk radius, phi/2pi; cylinder
// phi/2pi, z. The one place where rays, surfaces and lights learn what a kind of shape is.
#include <algorithm>
#include <cmath>
#include <optional>

#include "tempera/core/vec.h"
#include "tempera/scene/geometry.h"

namespace tempera::analytic {

struct UnitHit {
  double t = 0;
  float u = 0, v = 0;
};

/// First intersection with tmin < t < tmax of o + t d, or nothing. Solved in double: callers hold float rays.
std::optional<UnitHit> intersect(AnalyticKind kind, const Vec3d& o, const Vec3d& d, double tmin, double tmax);

/// Where the line o + t d crosses the whole plane, sphere or infinite cylinder that the shape lies on, nearest to t =
/// `near`, with t, u and v exact to double rounding; or nothing.
struct LineHit {
  double t = 0, u = 0, v = 0;
};
std::optional<LineHit> cross_line(AnalyticKind kind, const Vec3d& o, const Vec3d& d, double near);

/// Position, outward unit normal and derivatives at (u, v), all in unit space. Near the poles of the sphere (and the
/// center of the disk) the derivatives with respect to the angle vanish.
template <class T>
struct UnitPoint {
  Vec3<T> p, n, dpdu, dpdv, dndu, dndv;
};
UnitPoint<double> evaluate(AnalyticKind kind, double u, double v);
UnitPoint<float> evaluate(AnalyticKind kind, float u, float v);

/// Box around the unit shape.
Bounds3f unit_bounds(AnalyticKind kind);
/// Box around the shape that `map` makes of the unit shape: the smallest, to rounding.
Bounds3f bounds(AnalyticKind kind, const Affine3d& map);
/// Area of the unit shape.
constexpr float unit_area(AnalyticKind kind) {
  return kind == AnalyticKind::kSphere ? 4 * kPi : kind == AnalyticKind::kDisk ? kPi : 2 * kPi;
}
/// (u, v) of a point that is spread evenly over the area of the unit shape, for `x` even in [0,1)^2.
TEMPERA_INLINE Vec2f sample(AnalyticKind kind, const Vec2f& x) {
  if (kind == AnalyticKind::kSphere) return {x.x, std::acos(1 - 2 * x.y) * kInvPi};
  if (kind == AnalyticKind::kDisk) return {std::sqrt(x.x), x.y};
  return x;
}
/// (u, v) of the point in unit direction `n` on the unit sphere.
TEMPERA_INLINE Vec2f sphere_uv(const Vec3f& n) {
  const float u = std::atan2(n.y, n.x) * (0.5f * kInvPi);
  return {u < 0 ? u + 1 : u, std::acos(std::clamp(n.z, -1.0f, 1.0f)) * kInvPi};
}

}  // namespace tempera::analytic
