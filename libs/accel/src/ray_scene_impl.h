// SPDX-License-Identifier: Apache-2.0
#pragma once
// What building, evaluating surfaces and tracing rays share.
#include <memory>
#include <span>
#include <vector>

#include "geometry_cache.h"
#include "motion.h"
#include "tempera/accel/ray_scene.h"
#include "tempera/core/error.h"

namespace tempera {

struct RayScene::Impl {
  const Scene* scene = nullptr;
  GeometryCache::Impl* cache = nullptr;
  TimeSpan rays;
  MotionPieces pieces;                        // of the evaluation span
  std::size_t first_knot = 0, last_knot = 0;  // of the ray span, among those of `pieces`
  double ray_begin = 0, ray_scale = 0;        // Embree's time = (t - ray_begin) * ray_scale
  float largest_inverse = 1;                  // by which an instance may scale up a ray, at most
  RTCScene top = nullptr;                     // own_top, or the static scene itself
  EmbreeScene own_top;
  bool top_is_static = false;
  Bounds3f bounds;
  std::uint64_t vertex_bytes = 0;

  /// What an Embree id of the top scene stands for.
  struct TopEntry {
    enum Kind : std::uint8_t { kStaticScene, kInstance, kShape } kind = kStaticScene;
    std::uint32_t instance = 0;
    std::uint32_t shape = 0;
  };
  std::vector<TopEntry> top_entries;

  /// Instanced motion: at the knots of the evaluation span, or one constant map.
  struct InstanceMotion {
    bool moves = false;
    std::vector<AffineKnot> knots;
    Affine3f world;
  };
  std::vector<InstanceMotion> motions;                  // by instance; used for instanced placement only
  std::vector<std::unique_ptr<PlacedShape>> deforming;  // own copies with this span's vertices
  std::vector<const PlacedShape*> placed;               // like cache->placed, deforming ones replaced

  std::vector<const PlacedShape*> single_shape;  // by instance: its one shape, or null for groups of several

  const PlacedShape& find(std::uint32_t instance, std::uint32_t shape) const {
    if (const PlacedShape* p = single_shape[instance]) return *p;
    const auto& group = scene->groups[scene->instances[instance].group];
    std::size_t i = cache->first_placed[instance];
    for (std::size_t k = 0; std::uint32_t(group[k]) != shape; ++k) ++i;
    return *placed[i];
  }
  float embree_time(double t) const {
    TEMPERA_ASSERT(t >= rays.begin - time_rounding() && t <= rays.end + time_rounding());
    return float(std::clamp((t - ray_begin) * ray_scale, 0.0, 1.0));
  }
  struct Position {
    std::size_t knot = 0;
    float blend = 0;
  };
  Position locate(double t) const {
    const MotionPieces::Position at = pieces.locate(t);
    return {at.knot, float(at.blend)};
  }
  double time_rounding() const { return 1e-9 * pieces.grid().step; }

  void build_motions();
  std::span<const AffineKnot> ray_knots(const InstanceMotion& m) const {
    return {m.knots.data() + first_knot, last_knot - first_knot + 1};
  }
  void build_deforming(PlacedShape& shape);
  void attach(std::uint32_t instance);
  void attach_own(std::uint32_t instance, std::size_t slot, std::uint32_t shape, bool visible, Placement placement);
  void attach_instance(std::uint32_t instance);
  Affine3f world(std::uint32_t instance, double t) const;
  struct Triangle {
    Vec3f p[3], n[3];
    bool smooth = false;
  };
  /// Vertices of a mesh's triangle at time t in the frame that Embree sees (world, or object for instanced ones).
  Triangle triangle(const PlacedShape& placed, std::uint32_t primitive, double t) const;
  Triangle blended_triangle(const PlacedShape& placed, std::uint32_t primitive, double t) const;
  Triangle knot_triangle(const PlacedShape& placed, std::uint32_t primitive, std::size_t knot) const;
  /// The same in double with its derivatives by time (per second); normals are of unit length for deforming meshes
  /// only.
  struct MovingTriangle {
    Vec3d p[3], n[3], dpdt[3], dndt[3];
    bool smooth = false;
  };
  MovingTriangle moving_triangle(const PlacedShape& placed, std::uint32_t primitive, double t) const;
  /// Map of an instance at time t in double, and its derivative (per second).
  MovingAffine moving_world(std::uint32_t instance, double t) const;
  MovingAffine moving_world(std::uint32_t instance, double t, PoseCache* poses) const;
  /// World positions of all vertices of a deforming mesh at a knot: in `storage` if not in memory anyway.
  const Vec3f* positions_at(const PlacedShape& placed, std::size_t knot, std::vector<Vec3f>& storage) const;
  Bounds3f swept_mesh(const PlacedShape& placed, TimeSpan span) const;
  Bounds3f swept_instance(const PlacedShape& placed, std::uint32_t instance, TimeSpan span) const;
  /// Whether the triangles of a mesh show their backs at time t, because its place is mirrored.
  bool mirrored(const PlacedShape& placed, double t) const;
};

}  // namespace tempera
