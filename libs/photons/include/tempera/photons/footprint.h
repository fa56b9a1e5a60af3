// SPDX-License-Identifier: Apache-2.0
#pragma once
// The footprint of a photon on a surface: an ellipse that moves while the shutter is open. How its flux is spread over
// it, and over the way that it takes. [Schjoth 2010, Sec. 3.3 and 4]
//
//   M        maps offsets on the surface (m) to filter space, where the ellipse is the unit disk
//   A_0      area of the ellipse, m^2
//   y        squared distance from the center in filter space
//   sigma    time since the instant at which the photon was traced, s
#include <array>
#include <cstdint>
#include <span>

#include "tempera/core/vec.h"

namespace tempera {

/// Kernels over the unit disk, each of integral pi. [Schjoth 2010, Table 1]
enum class SpatialKernel : std::uint8_t {
  kUniform,
  kEpanechnikov,
  kBiweight,
  kGaussian  ///< of the variance of kEpanechnikov, out to where 1.1 % is left
};
/// K(y); 0 beyond its support.
float spatial_kernel(SpatialKernel kernel, float y);
/// Radius of the support in filter space.
float support(SpatialKernel kernel);

/// How a moving footprint stands for the exposure.
enum class Sweep : std::uint8_t {
  kLine,      ///< the mean over the exposure of what the moving kernel gives: exact
  kClamped,   ///< the kernel about the nearest place of its way, in filter space, with the area that belongs to it
  kPublished  ///< [Schjoth 2010, Eq. 7]: about the nearest place in the world; right for the uniform kernel alone
};

/// How light counts while the shutter is open. [Schjoth 2010, Eq. 9]
enum class TimeFilter : std::uint8_t {
  kBox,   ///< evenly
  kDecay  ///< by the kernel of the paper's Table 2 from the photon's own instant on, scaled to a mean of 1
};
/// Weight at |sigma| / exposure = s in [0,1]; its mean over [0,1] is 1. [Schjoth 2010, Table 2]
float time_weight(TimeFilter filter, SpatialKernel kernel, float s);

/// How light of photons is estimated.
struct KernelSettings {
  SpatialKernel kernel = SpatialKernel::kEpanechnikov;
  Sweep sweep = Sweep::kLine;
  TimeFilter filter = TimeFilter::kBox;
  /// From when to when the shutter is open, since the photons' instant; equal: they do not move.
  double begin = 0, end = 0;
};

/// The two half axes of an ellipse, perpendicular to each other, each of twice the length that `axes` limit.
struct FootprintAxes {
  Vec3f a, b;
};
/// The ellipse that columns of a beam spread over a surface with unit normal n (m, in its plane or not): principal axes
/// of the sum of c c^T, each as long as the root of its eigenvalue, clamped to [2 least, 2 most]. The ellipse of two
/// columns is the one inscribed in their parallelogram. `clamped`: whether an axis was.
FootprintAxes footprint_axes(std::span<const Vec3d> columns, const Vec3d& n, double least, double most,
                             bool* clamped = nullptr);

/// An ellipse with its way, ready to be evaluated. The axes are those of footprint_axes.
struct Footprint {
  Vec3f center;
  Vec3f m1, m2;            ///< rows of M [Schjoth 2010, Eq. 8]
  Vec2f w;                 ///< M D_t: motion in filter space, 1/s
  float slowness = 0;      ///< 1 / |w|, s; 0: it stands still
  float inverse_area = 0;  ///< 1 / A_0

  Footprint() = default;
  /// `velocity`: m/s, in the plane of the axes.
  Footprint(const Vec3f& center, const FootprintAxes& axes, const Vec3f& velocity);
  Vec2f to_filter(const Vec3f& offset) const { return {dot(m1, offset), dot(m2, offset)}; }
  /// Makes the ellipse wider; it moves as it does.
  void widen(float factor) {
    m1 *= 1 / factor, m2 *= 1 / factor, w *= 1 / factor;
    slowness *= factor;
    inverse_area *= 1 / (factor * factor);
  }
  /// Velocity on the surface, m/s.
  Vec3f velocity() const;
  /// Half axes, in m: lengths 1 / |m1| and 1 / |m2|.
  FootprintAxes half_axes() const;
};

/// Mean over the exposure of the flux per area that a unit of flux gives at center + offset, 1/m^2. `rate`: of the flux,
/// 1/s; it is never below 0.
float swept_density(const Footprint& f, const KernelSettings& settings, const Vec3f& offset, float rate);
/// The same at sigma alone.
float instant_density(const Footprint& f, SpatialKernel kernel, const Vec3f& offset, float sigma, float rate);

/// Box that holds all places with density above 0, thickened by `thickness` on both sides of the plane with unit normal
/// n.
Bounds3f footprint_bounds(const Footprint& f, const KernelSettings& settings, const Vec3f& n, float thickness);

}  // namespace tempera
