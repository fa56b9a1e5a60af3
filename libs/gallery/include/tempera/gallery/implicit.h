// SPDX-License-Identifier: Apache-2.0
#pragma once
// Solids given by signed distances, blended and turned into closed meshes: for bodies, vessels and other shapes that
// no lathe makes. Distances are negative inside and need to be right only near the surface.
#include <functional>
#include <span>

#include "tempera/gallery/polygons.h"

namespace tempera::gallery {

using Distance = std::function<double(const Vec3d&)>;

/// The surface d = 0 inside of the box as one closed mesh, if the solid lies in the box: one vertex per cell that the
/// surface crosses, moved onto it, joined by quadrilaterals [Gibson 1998]. Normals follow the gradient of d; texture
/// coordinates are zero. `cell` is the edge of a cell in metres: finer details are lost.
/// Threads: uses parallel_for; the result does not depend on it.
Polygons polygonize(const Distance& d, const Vec3d& lo, const Vec3d& hi, double cell);

double ball(const Vec3d& p, const Vec3d& center, double radius);
/// Ellipsoid at the origin; the distance is an approximation that is exact to first order.
double ellipsoid(const Vec3d& p, const Vec3d& radii);
/// Segment a-b with radii that go linearly from one end to the other.
double limb(const Vec3d& p, const Vec3d& a, const Vec3d& b, double radius_a, double radius_b);
/// Polyline with a radius per point.
double bent_limb(const Vec3d& p, std::span<const Vec3d> path, std::span<const double> radii);
/// Solid of revolution about y; `outline` is (radius, height) along the outside from the lower to the upper pole.
double turned_solid(const Vec3d& p, std::span<const Vec2d> outline);

/// Union whose edge is rounded over about `k` metres; `k` 0 keeps it sharp.
double blend(double a, double b, double k);
/// a without b, likewise.
double carve(double a, double b, double k);

}  // namespace tempera::gallery
