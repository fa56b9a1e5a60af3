// SPDX-License-Identifier: Apache-2.0
#pragma once
// A scene resampled over one span of time for ray queries, and points that stay glued to its matter.
//
// All motion is resampled to knots on one global grid of the shot's axis (`motion_step` seconds apart, knot k at k *
// step): deforming vertices and skins are linear between knots, rigid motion is interpolated as translation, rotation
// (slerp) and upper-triangular scale. Hits, normals, light samples and motion vectors all use that same resampled
// motion, and two RaySceneS over different spans of one shot agree exactly, because the grid does not depend on the
// span. Nothing lies between the two poses of a jump (motion_grid.h).
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "tempera/core/time.h"
#include "tempera/core/vec.h"
#include "tempera/scene/scene.h"

namespace tempera {

/// Bounds of a ray query. `d` need not be unit length; hits are at o + t d with tmin < t < tmax.
struct Ray {
  Vec3f o, d;
  float tmin = 0, tmax = kInfinity;
  double time = 0;  ///< seconds; must lie in the RayScene's ray span (asserted)
};

/// A point glued to matter: re-evaluable at any time of the evaluation span.
struct SurfacePoint {
  std::uint32_t instance = 0;   ///< Scene::instances index
  std::uint32_t shape = 0;      ///< Scene::shapes index
  std::uint32_t primitive = 0;  ///< triangle of a mesh; 0 for analytic shapes
  float u = 0, v = 0;           ///< triangle barycentrics of vertices 1 and 2; analytic shapes: their uv
  bool operator==(const SurfacePoint&) const = default;
};

struct Hit {
  SurfacePoint point;
  float t = 0;
};

/// A surface to first order around one of its points, in world space: by its parameters u, v (as in SurfacePoint) and
/// by time, per second, with u and v held fixed.
struct SurfaceFrame {
  Vec3d p;           ///< position
  Vec3d ng, n;       ///< unit geometric and shading normals: equal where a surface has one of them alone
  Vec3d dpdu, dpdv;  ///< zero by the angle at the poles of a sphere and the center of a disk
  Vec3d dndu, dndv;
  Vec3d dpdt, dndt, dngdt;
  double area_rate = 0;  ///< relative growth of the area of its matter, 1/s
};

/// Where a ray crosses a primitive: its parameters, and the distance in units of the length of the ray's direction.
struct PrimitiveHit {
  double u = 0, v = 0;
  double distance = 0;
};

/// How position and unit shading normal of a surface change with its texture coordinates: world space, per unit uv.
/// Tangents are arbitrary, and the normal's derivatives zero, where the uv coordinates degenerate.
struct SurfaceDerivatives {
  Vec3f dpdu, dpdv, dndu, dndv;
};

/// One of two points that may see each other.
struct SurfaceEnd {
  Vec3d p;  ///< world space
  Vec3f
      ng;  ///< unit geometric normal, of either side; zero for what lies on no surface, as lamps without size and lenses
};

struct RaySceneOptions {
  double motion_step = 1.0 / 96;  ///< seconds between knots of the resampling grid, > 0
  bool robust = false;            ///< Embree's watertight mode, about 5 % slower
};

class RayScene;

/// Embree geometry of matter that does not move, shared by the RayScenes of a sequence.
class GeometryCache {
 public:
  GeometryCache();
  ~GeometryCache();
  GeometryCache(const GeometryCache&) = delete;
  GeometryCache& operator=(const GeometryCache&) = delete;

 private:
  friend class RayScene;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The last places of moving instances that were asked for, for those who ask about the same few times again and again:
/// what it holds is what would be computed. The RayScenes that it is used with must outlive it. Threads: one thread each.
class PoseCache {
 public:
  PoseCache();
  ~PoseCache();
  PoseCache(const PoseCache&) = delete;
  PoseCache& operator=(const PoseCache&) = delete;

 private:
  friend class RayScene;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Threads: const queries are re-entrant.
class RayScene {
 public:
  /// Builds for rays with times in `rays`, within which nothing may jump (see exposure_pieces): matter is visible as it
  /// is in the middle. Points can be evaluated over `evaluation`, which is extended to include `rays`.
  /// Errors: Error{kOutOfRange} if the span needs more than 128 motion segments; Error{kOutOfMemory}.
  /// `scene` and `cache` must outlive this.
  RayScene(const Scene& scene, TimeSpan rays, TimeSpan evaluation, const RaySceneOptions& options,
           GeometryCache& cache);
  ~RayScene();
  RayScene(RayScene&&) noexcept;
  RayScene(const RayScene&) = delete;
  RayScene& operator=(const RayScene&) = delete;

  /// Rays that are not finite, or reach beyond 1e18, hit nothing: what is computed from them is not finite either, and
  /// is counted where it is added up.
  std::optional<Hit> intersect(const Ray& ray) const;
  /// The same into `hit`, which stays as it is if the ray hits nothing. Returns whether it does.
  bool intersect(const Ray& ray, Hit& hit) const;
  /// Whether anything lies within (tmin, tmax). Surfaces with opacity below 1 count as opaque here.
  bool occluded(const Ray& ray) const;
  /// Whether nothing lies between two points at time t: the same if they are exchanged, to the bit. Each is moved off
  /// its surface towards the other one first, as by offset_origin. Surfaces with opacity below 1 count as opaque.
  /// Points at one place see each other; false if one is not finite.
  bool visible(const SurfaceEnd& a, const SurfaceEnd& b, double t) const;

  /// Everything a material needs at `point` at time `t`, seen from unit direction `wo`.
  ShadingPoint shading_point(const SurfacePoint& point, double t, const Vec3f& wo) const;
  /// World position alone, and the unit geometric normal if `ng` is not null.
  Vec3f position(const SurfacePoint& point, double t, Vec3f* ng = nullptr) const;
  SurfaceDerivatives derivatives(const SurfacePoint& point, double t) const;
  /// The surface that `point` lies on, at parameters (u, v) instead of the point's own, in double: from the knots that
  /// rays meet, with the derivatives of that very interpolation. At a knot they are those of the segment after it, at
  /// the last one those of the segment before. Normals and their derivatives are zero where no surface is left, and
  /// those of flat triangles by u and v always. Materials may bend n further, which this does not know.
  SurfaceFrame surface(const SurfacePoint& point, double u, double v, double t, PoseCache* poses = nullptr) const;
  /// Where the line o + distance d crosses the primitive of `hit`, in double, for hits of a ray that is this one
  /// rounded to float: surface(hit.point, u, v, t).p lies on the line to double rounding. Of two crossings the one
  /// nearer to hit.t is taken. Empty where there is none: for lines in the plane of the primitive or past the curve of
  /// its shape, and for crossings outside of it by more than 1e-4 of the range of u or v plus 2e-6 of the coordinates
  /// of the ray's origin and of the point. Nothing is clamped: u and v may lie outside by that much.
  std::optional<PrimitiveHit> refine(const Hit& hit, const Vec3d& o, const Vec3d& d, double t,
                                     PoseCache* poses = nullptr) const;
  /// World area of triangle `primitive` of a mesh shape at time t, with its unit geometric normal.
  float triangle_area(std::uint32_t instance, std::uint32_t shape, std::uint32_t primitive, double t) const;
  /// Map of an analytic shape from its unit space (scene/geometry.h) to the world at time t: one that can be inverted,
  /// so flattened shapes have a thickness of a millionth. Pre: the shape is analytic.
  Affine3f world_from_unit(std::uint32_t instance, std::uint32_t shape, double t) const;

  /// Whether any point of a shape of an instance is in more than one place within `span`, by its node, skin, morph
  /// targets or vertex cache, as resampled: a knot beyond the end of the span counts if motion up to it is blended in.
  /// Hidden things move, too; the camera is none of it.
  bool moves(std::uint32_t instance, std::uint32_t shape, TimeSpan span) const;
  /// World box that holds a shape of an instance, hidden or not, at every time in `span` as rays meet it: turning
  /// between knots and rounding included. For analytic shapes, and meshes that deform or never move, it is the smallest
  /// one but for rounding (1e-5 of the coordinates) and, of what turns, at most a fortieth of its way. A mesh that its
  /// node moves, or that several instances share, is held by its box and a ball in its own space: unless it is
  /// stretched, by at most three times the diagonal that it needs at a time. Empty for a mesh without triangles. Looks
  /// at every triangle of meshes that deform (at each knot) or never move.
  Bounds3f swept_bounds(std::uint32_t instance, std::uint32_t shape, TimeSpan span) const;

  const Shape& shape(const SurfacePoint& point) const { return scene_->shapes[point.shape]; }
  /// Whether any material in the scene lets light pass straight through.
  bool has_opacity() const { return has_opacity_; }
  const Scene& scene() const { return *scene_; }
  TimeSpan rays() const;
  Bounds3f bounds() const;
  /// Origin for a ray that leaves the surface at `p` towards `d`: moved off the surface by its numerical uncertainty.
  Vec3f offset_origin(const Vec3f& p, const Vec3f& ng, const Vec3f& d) const {
    const float magnitude = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
    const float offset = std::max(3e-5f * magnitude, smallest_offset_);
    return p + ng * std::copysign(offset, dot(ng, d));
  }
  /// Bytes held by Embree and by vertex buffers of this RayScene and its cache.
  std::uint64_t memory() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
  // What is asked at every hit.
  const Scene* scene_;
  float smallest_offset_ = 0;
  bool has_opacity_ = false;
};

}  // namespace tempera
