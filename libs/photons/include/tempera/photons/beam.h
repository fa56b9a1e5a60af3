// SPDX-License-Identifier: Apache-2.0
#pragma once
// A photon as a beam: a ray from a light with its first derivatives by coordinates of emission and by time, carried
// through a scene in which everything may move. [Schjoth 2010, Sec. 3; Igehy 1999]
#include <array>

#include "tempera/accel/ray_scene.h"

namespace tempera {

/// A ray and how it changes. Columns 0 to 3 are those of emission, of which a light without size has two and others two
/// for the position and two for the direction; each is as long as the part of the light that one photon stands for, so
/// that their spread at a surface is the footprint of the photon. Column kTime is the derivative by time, per second.
/// [Schjoth 2010, Eq. 1 and 2]
struct Beam {
  static constexpr int kSpatial = 4, kTime = 4, kColumns = 5;
  using Columns = std::array<Vec3d, kColumns>;
  Vec3d x;  ///< where the ray begins, or has arrived
  Vec3d w;  ///< unit direction in which light travels; dot(w, dw[i]) is 0
  Columns dx{}, dw{};
};

/// Moves a beam over `distance` (m) to where it meets a surface, which may move and deform. The rays of all its
/// columns arrive on the surface. [Schjoth 2010, Eq. 4] Pre: f.ng is not perpendicular to the ray.
void transfer(const SurfaceFrame& f, double distance, Beam& beam);

/// How a point of the surface, as each column of a beam that has arrived moves over it, changes by the parameters of
/// the surface.
struct MatterChange {
  std::array<double, Beam::kColumns> u{}, v{};
};
MatterChange matter_change(const SurfaceFrame& f, const Beam& beam);
/// Derivatives of the shading normal f.n where a beam has arrived. [Schjoth 2010, Eq. 6]
Beam::Columns normal_change(const SurfaceFrame& f, const MatterChange& change);

/// Mirrors a beam about the unit normal n, of either side, with derivatives dn.
void reflect(const Vec3d& n, const Beam::Columns& dn, Beam& beam);
/// Refracts a beam at a surface with unit normal n, of either side, with derivatives dn. `eta`: index of refraction on
/// the far side over that on the near one. Close to total reflection derivatives are limited. Returns false, and leaves
/// the beam as it is, if it is reflected totally.
bool refract(const Vec3d& n, const Beam::Columns& dn, double eta, Beam& beam);
/// Where facets scatter a beam about another normal than the surface's: the derivatives of `n` turned with it to `m`.
Beam::Columns turned(const Beam::Columns& dn, const Vec3d& n, const Vec3d& m);

/// Spreads a beam: two more columns of directions, perpendicular to it and to each other, each of `length` (radians).
/// The columns of emission after it have the same spread at every surface as all six would.
void widen(double length, Beam& beam);

/// The lamp or place that a photon comes from, as time passes.
struct EmitterMotion {
  bool parallel = false;  ///< the light comes from infinity
  Vec3d velocity;         ///< m/s of the place; 0 if parallel
  Vec3d turn;             ///< rad/s, about which a parallel light's direction turns
};
/// Makes the photon one that stays with the matter that it first meets: replaces the derivatives by time of a beam that
/// has arrived after `distance`. Returns the relative rate of the flux through that matter, 1/s. Followed through what
/// moves, such a photon stays on it, where one of a fixed direction would be swept across.
double follow_matter(const SurfaceFrame& f, const EmitterMotion& emitter, double distance, Beam& beam);

}  // namespace tempera
