// SPDX-License-Identifier: Apache-2.0
#include "tempera/accel/ray_scene.h"

#include <embree3/rtcore.h>
#include <fmt/format.h>

#include "geometry_cache.h"
#include "motion.h"
#include "tempera/core/error.h"
#include "tempera/core/parallel.h"

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
    const auto& group = scene->groups[std::size_t(scene->instances[instance].group)];
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
  /// Position of a point of an instanced shape in the instance's space.
  Vec3f object_position(const PlacedShape& placed, const SurfacePoint& point) const;
  /// Whether the triangles of a mesh show their backs at time t, because its place is mirrored.
  bool mirrored(const PlacedShape& placed, double t) const;
};

void RayScene::Impl::build_motions() {
  motions.resize(scene->instances.size());
  const auto& knots = pieces.knots();
  const TimeSpan evaluation{knots.front().time, knots.back().time};
  std::vector<Affine3d> worlds(knots.size());
  for (std::size_t i = 0; i < motions.size(); ++i) {
    const int node = scene->instances[i].node;
    InstanceMotion& m = motions[i];
    const auto world = [&](std::size_t k) { return scene->world(node, knots[k].time, knots[k].piece); };
    m.world = Affine3f(world(first_knot));
    m.moves = scene->moves(node, evaluation);
    if (!m.moves) continue;
    for (std::size_t k = 0; k < knots.size(); ++k) worlds[k] = world(k);
    m.knots = decompose(worlds);
  }
}

Affine3f RayScene::Impl::world(std::uint32_t instance, double t) const {
  const InstanceMotion& m = motions[instance];
  if (!m.moves) return m.world;
  const auto [knot, blend] = locate(t);
  return blend == 0 ? compose(m.knots[knot]) : interpolate(m.knots[knot], m.knots[knot + 1], blend);
}

void RayScene::Impl::build_deforming(PlacedShape& placed_shape) {
  const Mesh& mesh = *placed_shape.mesh;
  const int node = scene->instances[placed_shape.instance].node;
  for (const MotionPieces::Knot& k : pieces.knots()) {
    placed_shape.poses.push_back(mesh_pose(*scene, mesh, node, k.time, k.piece));
  }
  placed_shape.mirrored = placed_shape.poses[first_knot].world.determinant() < 0;
  for (const MeshPose& pose : placed_shape.poses) {
    placed_shape.mirroring_changes |= (pose.world.determinant() < 0) != placed_shape.mirrored;
  }
  placed_shape.first_knot = first_knot;
  for (std::size_t k = first_knot; k <= last_knot; ++k) {
    const MeshPose& pose = placed_shape.poses[k];
    KnotVertices v;
    v.own_positions.reserve(mesh.positions.size() + 2);
    v.own_positions.resize(mesh.positions.size());
    v.own_normals.resize(mesh.normals.size());
    constexpr std::int64_t kBlock = 4096;
    const auto n = std::int64_t(mesh.positions.size());
    parallel_for(0, (n + kBlock - 1) / kBlock, [&](std::int64_t block) {
      for (std::int64_t i = block * kBlock; i < std::min(n, (block + 1) * kBlock); ++i) {
        v.own_positions[std::size_t(i)] = posed_position(mesh, pose, std::uint32_t(i));
        if (!mesh.normals.empty()) v.own_normals[std::size_t(i)] = posed_normal(mesh, pose, std::uint32_t(i));
      }
    });
    vertex_bytes += (v.own_positions.capacity() + v.own_normals.capacity()) * sizeof(Vec3f);
    placed_shape.knots.push_back(std::move(v));
    KnotVertices& stored = placed_shape.knots.back();
    stored.positions = stored.own_positions.data();
    stored.normals = mesh.normals.empty() ? nullptr : stored.own_normals.data();
  }
}

RayScene::Impl::Triangle RayScene::Impl::knot_triangle(const PlacedShape& p, std::uint32_t primitive,
                                                       std::size_t knot) const {
  Triangle t;
  const Mesh& mesh = *p.mesh;
  t.smooth = !mesh.normals.empty();
  const bool in_memory = knot >= p.first_knot && knot - p.first_knot < p.knots.size();
  for (int c = 0; c < 3; ++c) {
    const std::uint32_t v = mesh.indices[3 * std::size_t(primitive) + std::size_t(c)];
    if (in_memory) {
      const KnotVertices& k = p.knots[knot - p.first_knot];
      t.p[c] = k.positions[v];
      if (t.smooth) t.n[c] = k.normals[v];
    } else {  // outside the span of rays: the same function that filled the buffers, for three vertices
      t.p[c] = posed_position(mesh, p.poses[knot], v);
      if (t.smooth) t.n[c] = posed_normal(mesh, p.poses[knot], v);
    }
  }
  return t;
}

RayScene::Impl::Triangle RayScene::Impl::blended_triangle(const PlacedShape& p, std::uint32_t primitive,
                                                          double time) const {
  const auto [knot, blend] = locate(time);
  Triangle a = knot_triangle(p, primitive, knot);
  if (blend == 0) return a;
  const Triangle b = knot_triangle(p, primitive, knot + 1);
  for (int c = 0; c < 3; ++c) {
    a.p[c] = lerp(a.p[c], b.p[c], blend);
    if (a.smooth) a.n[c] = normalize(lerp(a.n[c], b.n[c], blend));
  }
  return a;
}

TEMPERA_INLINE RayScene::Impl::Triangle RayScene::Impl::triangle(const PlacedShape& p, std::uint32_t primitive,
                                                                 double time) const {
  if (p.placement == Placement::kDeforming) return blended_triangle(p, primitive, time);
  const std::uint32_t* v = &p.mesh->indices[3 * std::size_t(primitive)];
  const KnotVertices& k = p.knots[0];
  if (!k.normals) return {{k.positions[v[0]], k.positions[v[1]], k.positions[v[2]]}, {}, false};
  return {{k.positions[v[0]], k.positions[v[1]], k.positions[v[2]]},
          {k.normals[v[0]], k.normals[v[1]], k.normals[v[2]]},
          true};
}

bool RayScene::Impl::mirrored(const PlacedShape& p, double t) const {
  if (!p.mirroring_changes) return p.mirrored;
  // Vertices are linear between knots, so their map is, too.
  const auto [knot, blend] = locate(t);
  const Affine3f& a = p.poses[knot].world;
  if (blend == 0) return a.determinant() < 0;
  const Affine3f& b = p.poses[knot + 1].world;
  return Affine3f{lerp(a.x, b.x, blend), lerp(a.y, b.y, blend), lerp(a.z, b.z, blend)}.determinant() < 0;
}

Vec3f RayScene::Impl::object_position(const PlacedShape& p, const SurfacePoint& point) const {
  if (!p.mesh) {
    return p.analytic.object_from_unit.point(analytic::evaluate(p.analytic.kind, point.u, point.v).p);
  }
  const std::uint32_t* v = &p.mesh->indices[3 * std::size_t(point.primitive)];
  const Vec3f* at = p.knots[0].positions;
  return at[v[0]] * (1 - point.u - point.v) + at[v[1]] * point.u + at[v[2]] * point.v;
}

namespace {

Bounds3f bounds_of(RTCScene scene) {
  RTCBounds b;
  rtcGetSceneBounds(scene, &b);
  if (!(b.lower_x <= b.upper_x)) return {};
  return {{b.lower_x, b.lower_y, b.lower_z}, {b.upper_x, b.upper_y, b.upper_z}};
}

}  // namespace

/// Puts a copy of a shape into the top scene that is placed anew in this span.
void RayScene::Impl::attach_own(std::uint32_t instance, std::size_t slot, std::uint32_t shape, bool visible,
                                Placement placement) {
  auto own = std::make_unique<PlacedShape>(PlacedShape(*placed[slot]));
  own->instance = instance;
  own->placement = placement;
  placed[slot] = own.get();
  if (placement == Placement::kDeforming) {
    own->knots.clear();
    build_deforming(*own);
    if (visible) cache->add_geometry(top, *own, RTC_BUILD_QUALITY_MEDIUM);
  } else {
    own->moving.world = [this, instance](double t) { return world(instance, t); };
    own->moving.begin = ray_begin;
    own->moving.duration = ray_scale > 0 ? 1 / ray_scale : 0;
    for (std::size_t k = first_knot; k <= last_knot; ++k) {
      // Between knots it turns about its node's origin, which moves straight: boxes around spheres hold all of that.
      const InstanceMotion& motion = motions[instance];
      const Affine3f m = motion.moves ? compose(motion.knots[k]) : motion.world;
      const Bounds3f unit = analytic::unit_bounds(own->analytic.kind);
      float radius = 0;
      for (int c = 0; c < 8; ++c) {
        const Vec3f corner{c & 1 ? unit.hi.x : unit.lo.x, c & 2 ? unit.hi.y : unit.lo.y, c & 4 ? unit.hi.z : unit.lo.z};
        radius = std::max(radius, length(m.vector(own->analytic.object_from_unit.point(corner))));
      }
      own->moving.bounds.extend(m.translation - Vec3f{radius, radius, radius});
      own->moving.bounds.extend(m.translation + Vec3f{radius, radius, radius});
    }
    if (visible) cache->add_geometry(top, *own, RTC_BUILD_QUALITY_MEDIUM);
  }
  if (visible) top_entries.push_back({TopEntry::kShape, instance, shape});
  deforming.push_back(std::move(own));
}

/// Puts what is not static of an instance into the top scene.
void RayScene::Impl::attach(std::uint32_t i) {
  const Instance& instance = scene->instances[i];
  const auto& group = scene->groups[std::size_t(instance.group)];
  const double representative = 0.5 * (rays.begin + rays.end);
  bool visible = scene->visible(instance.node, representative);
  const InstanceMotion& m = motions[i];
  const AffineKnot still = decompose(Affine3d(m.world));
  const auto knots = m.moves ? ray_knots(m) : std::span<const AffineKnot>(&still, 1);
  // Embree takes rays into an instance's space, which must exist. What is flat, or becomes so, is placed in the world.
  const bool invertible = is_invertible(knots);
  const bool gone = !invertible && vanishes(knots);
  bool instanced = false;
  for (std::size_t k = 0; k < group.size(); ++k) {
    const std::size_t slot = cache->first_placed[i] + k;
    const auto shape = std::uint32_t(group[k]);
    const Placement placement = cache->placements[slot];
    if (placement == Placement::kDeforming) {
      const auto& mesh = std::get<Mesh>(scene->shapes[shape].geometry);
      attach_own(i, slot, shape, visible && !(gone && mesh.skin.joints.empty()), placement);
    } else if (placement == Placement::kInstanced) {
      instanced = true;
      if (invertible || gone) continue;
      attach_own(i, slot, shape, visible, placed[slot]->mesh ? Placement::kDeforming : Placement::kInstanced);
    }
  }
  if (instanced && visible && invertible) attach_instance(i);
}

void RayScene::Impl::attach_instance(std::uint32_t i) {
  RTCScene group = cache->group_scenes.at(scene->instances[i].group).scene;
  const Bounds3f box = bounds_of(group);
  if (box.empty()) return;
  RTCGeometry g = rtcNewGeometry(cache->device, RTC_GEOMETRY_TYPE_INSTANCE);
  rtcSetGeometryInstancedScene(g, group);
  const InstanceMotion& m = motions[i];
  const auto knots = m.moves ? ray_knots(m) : std::span<const AffineKnot>{};
  const bool still = std::all_of(knots.begin(), knots.end(), [&](const AffineKnot& k) { return k == knots[0]; });
  const auto note_inverse = [&](const Affine3f& map) {
    const Affine3f inv = inverse(map);
    largest_inverse = std::max(largest_inverse, 2 * (length(inv.x) + length(inv.y) + length(inv.z)));
  };
  if (still) {  // also without knots
    const Affine3f w = knots.empty() ? m.world : compose(knots[0]);
    note_inverse(w);
    rtcSetGeometryTransform(g, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, &w);
  } else {
    rtcSetGeometryTimeStepCount(g, unsigned(knots.size()));
    for (std::size_t k = 0; k < knots.size(); ++k) {
      const AffineKnot& knot = knots[k];
      note_inverse(compose(knot));
      RTCQuaternionDecomposition q;
      rtcInitQuaternionDecomposition(&q);
      rtcQuaternionDecompositionSetQuaternion(&q, knot.q.w, knot.q.x, knot.q.y, knot.q.z);
      rtcQuaternionDecompositionSetScale(&q, knot.scale.x, knot.scale.y, knot.scale.z);
      rtcQuaternionDecompositionSetSkew(&q, knot.skew.x, knot.skew.y, knot.skew.z);
      rtcQuaternionDecompositionSetTranslation(&q, knot.translation.x, knot.translation.y, knot.translation.z);
      rtcSetGeometryTransformQuaternion(g, unsigned(k), &q);
    }
  }
  rtcCommitGeometry(g);
  rtcAttachGeometry(top, g);
  rtcReleaseGeometry(g);
  top_entries.push_back({TopEntry::kInstance, i, 0});
}

RayScene::RayScene(const Scene& scene, TimeSpan rays, TimeSpan evaluation, const RaySceneOptions& options,
                   GeometryCache& cache)
    : impl_(std::make_unique<Impl>()), scene_(&scene) {
  Impl& s = *impl_;
  s.scene = &scene;
  s.cache = cache.impl_.get();
  s.cache->prepare(scene, options.robust);
  s.rays = rays;
  evaluation = {std::min(evaluation.begin, rays.begin), std::max(evaluation.end, rays.end)};
  const MotionGrid grid{options.motion_step};
  const std::int64_t first = grid.first(rays), last = std::max(grid.last(rays), first);
  if (last - first > kMaxSegments) {
    throw Error(
        ErrorCode::kOutOfRange,
        fmt::format("{} motion segments between {} s and {} s; at most {} fit one ray scene: use a shorter span or "
                    "fewer motion segments a frame",
                    last - first, rays.begin, rays.end, kMaxSegments));
  }
  std::vector<double> jumps;
  instance_jumps(scene, evaluation, jumps);
  s.pieces = MotionPieces(grid, evaluation, std::move(jumps), rays);
  s.first_knot = s.pieces.index(first);
  s.last_knot = s.pieces.index(last);
  s.ray_begin = grid.time(first);
  s.ray_scale = last > first ? 1.0 / (double(last - first) * grid.step) : 0;
  s.build_motions();

  for (const auto& p : s.cache->placed) s.placed.push_back(p.get());
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const auto& group = scene.groups[std::size_t(scene.instances[i].group)];
    for (std::size_t k = 0; k < group.size(); ++k) {
      const std::size_t slot = s.cache->first_placed[i] + k;
      if (!s.placed[slot]) s.placed[slot] = s.cache->object_shapes.at(std::uint32_t(group[k])).get();
    }
  }
  if (!s.cache->anything_moves) {
    s.top = s.cache->static_scene.scene;
    s.top_is_static = true;
  } else {
    s.own_top = EmbreeScene(rtcNewScene(s.cache->device));
    s.top = s.own_top.scene;
    rtcSetSceneBuildQuality(s.top, RTC_BUILD_QUALITY_MEDIUM);
    if (options.robust) rtcSetSceneFlags(s.top, RTC_SCENE_FLAG_ROBUST);
    if (!bounds_of(s.cache->static_scene.scene).empty()) {
      RTCGeometry g = rtcNewGeometry(s.cache->device, RTC_GEOMETRY_TYPE_INSTANCE);
      rtcSetGeometryInstancedScene(g, s.cache->static_scene.scene);
      rtcCommitGeometry(g);
      rtcAttachGeometry(s.top, g);
      rtcReleaseGeometry(g);
      s.top_entries.push_back({Impl::TopEntry::kStaticScene, 0, 0});
    }
    for (std::uint32_t i = 0; i < scene.instances.size(); ++i) s.attach(i);
    rtcCommitScene(s.top);
  }
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const bool single = scene.groups[std::size_t(scene.instances[i].group)].size() == 1;
    s.single_shape.push_back(single ? s.placed[s.cache->first_placed[i]] : nullptr);
  }
  check_device(s.cache->device);
  s.bounds = bounds_of(s.top);
  smallest_offset_ = 1e-6f * s.bounds.radius();
  has_opacity_ = s.cache->has_opacity;
}

RayScene::~RayScene() = default;
RayScene::RayScene(RayScene&&) noexcept = default;

namespace {

/// What Embree traces, also within instances, which scale rays up by `largest_inverse` at most. Others would end the
/// program where Embree was built with assertions, as Debian's is.
bool is_traceable(const Ray& r, float largest_inverse) {
  constexpr float kLargest = 1e18f;
  const float sum =
      std::abs(r.o.x) + std::abs(r.o.y) + std::abs(r.o.z) + std::abs(r.d.x) + std::abs(r.d.y) + std::abs(r.d.z);
  return sum * largest_inverse <= kLargest && r.tmin <= r.tmax;  // false for what is no number
}

}  // namespace

std::optional<Hit> RayScene::intersect(const Ray& ray) const {
  std::optional<Hit> hit(std::in_place);
  if (!intersect(ray, *hit)) hit.reset();
  return hit;
}

bool RayScene::intersect(const Ray& ray, Hit& hit) const {
  const Impl& s = *impl_;
  if (!is_traceable(ray, s.largest_inverse)) return false;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRayHit r;
  r.ray = {ray.o.x,  ray.o.y, ray.o.z, ray.tmin, ray.d.x, ray.d.y, ray.d.z, s.embree_time(ray.time),
           ray.tmax, ~0u,     0,       0};
  r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(s.top, &context, &r);
  if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;
  hit.t = r.ray.tfar;
  hit.point.primitive = r.hit.primID;
  hit.point.u = r.hit.u;
  hit.point.v = r.hit.v;
  const auto from_static = [&](unsigned geometry) {
    const PlacedShape& p = *s.cache->static_ids[geometry];
    hit.point.instance = p.instance;
    hit.point.shape = p.shape;
  };
  if (s.top_is_static) {
    from_static(r.hit.geomID);
  } else if (r.hit.instID[0] != RTC_INVALID_GEOMETRY_ID) {
    const Impl::TopEntry& e = s.top_entries[r.hit.instID[0]];
    if (e.kind == Impl::TopEntry::kStaticScene) {
      from_static(r.hit.geomID);
    } else {
      hit.point.instance = e.instance;
      hit.point.shape = std::uint32_t(s.scene->groups[std::size_t(s.scene->instances[e.instance].group)][r.hit.geomID]);
    }
  } else {
    const Impl::TopEntry& e = s.top_entries[r.hit.geomID];
    hit.point.instance = e.instance;
    hit.point.shape = e.shape;
  }
  return true;
}

bool RayScene::occluded(const Ray& ray) const {
  if (!is_traceable(ray, impl_->largest_inverse)) return false;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRay r{ray.o.x,  ray.o.y, ray.o.z, ray.tmin, ray.d.x, ray.d.y, ray.d.z, impl_->embree_time(ray.time),
           ray.tmax, ~0u,     0,       0};
  rtcOccluded1(impl_->top, &context, &r);
  return r.tfar < 0;
}

namespace {

/// Derivatives of functions that are linear over a triangle (values at its corners) with respect to its uv coordinates.
struct UvGradient {
  float a = 0, b = 0, c = 0, d = 0;  // d/du = a e1 + b e2, d/dv = c e1 + d e2 for edges e1, e2 from corner 0
  bool usable = false;
  explicit UvGradient(const Vec2f (&uv)[3]) {
    const Vec2f d1 = uv[1] - uv[0], d2 = uv[2] - uv[0];
    const float inv = 1 / (d1.x * d2.y - d1.y * d2.x);
    usable = std::isfinite(inv);
    if (usable) a = d2.y * inv, b = -d1.y * inv, c = -d2.x * inv, d = d1.x * inv;
  }
  Vec3f du(const Vec3f (&v)[3]) const { return (v[1] - v[0]) * a + (v[2] - v[0]) * b; }
  Vec3f dv(const Vec3f (&v)[3]) const { return (v[1] - v[0]) * c + (v[2] - v[0]) * d; }
};

/// Texture coordinates of a triangle's corners; its barycentrics where the mesh has none.
void corner_uvs(const Mesh& mesh, const std::uint32_t* v, Vec2f (&uv)[3]) {
  uv[0] = {0, 0}, uv[1] = {1, 0}, uv[2] = {0, 1};
  if (mesh.uvs.empty()) return;
  for (int c = 0; c < 3; ++c) uv[c] = mesh.uvs[v[c]];
}

}  // namespace

ShadingPoint RayScene::shading_point(const SurfacePoint& point, double t, const Vec3f& wo) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(point.instance, point.shape);
  ShadingPoint r;
  r.wo = wo;
  r.time = t;
  Vec3f ns;  // interpolated, not yet unit
  Vec3f tangent{};
  float tangent_sign = 1;
  bool flip = false;
  if (placed.mesh) {
    const Mesh& mesh = *placed.mesh;
    const Impl::Triangle tri = s.triangle(placed, point.primitive, t);
    const float b0 = 1 - point.u - point.v, b1 = point.u, b2 = point.v;
    r.p = tri.p[0] * b0 + tri.p[1] * b1 + tri.p[2] * b2;
    r.ng = normalize(cross(tri.p[1] - tri.p[0], tri.p[2] - tri.p[0]) * (s.mirrored(placed, t) ? -1.0f : 1.0f));
    const std::uint32_t* v = &mesh.indices[3 * std::size_t(point.primitive)];
    const auto interpolated = [&](const auto& values) {
      return values[v[0]] * b0 + values[v[1]] * b1 + values[v[2]] * b2;
    };
    r.uv = mesh.uvs.empty() ? Vec2f{b1, b2} : interpolated(mesh.uvs);
    r.uv1 = mesh.uvs1.empty() ? r.uv : interpolated(mesh.uvs1);
    ns = r.ng;
    if (tri.smooth) {
      ns = tri.n[0] * b0 + tri.n[1] * b1 + tri.n[2] * b2;
      const float l = length(ns);
      ns = l > 0 ? ns * (1 / l) : r.ng;
    }
    if (!mesh.colors.empty()) {
      if (mesh.color_per_face) {
        r.color = mesh.colors[point.primitive];
        if (!mesh.color_alphas.empty()) r.color_alpha = mesh.color_alphas[point.primitive];
      } else {
        r.color = interpolated(mesh.colors);
        if (!mesh.color_alphas.empty()) r.color_alpha = interpolated(mesh.color_alphas);
      }
    }
    if (placed.tangents) {
      Vec2f uv[3];
      corner_uvs(mesh, v, uv);
      if (const UvGradient g(uv); g.usable) {
        r.dpdu = g.du(tri.p), r.dpdv = g.dv(tri.p);
      } else {
        const Basis b(r.ng);
        r.dpdu = b.s, r.dpdv = b.t;
      }
      if (!mesh.tangents.empty()) {
        tangent = interpolated(mesh.tangents);
        if (!mesh.tangent_signs.empty()) tangent_sign = mesh.tangent_signs[v[0]];
        // Tangents are stored in the mesh's bind space; deformation turns them with dpdu, which is close enough for the
        // in-plane direction of a normal map.
        if (placed.placement == Placement::kDeforming && dot(r.dpdu, r.dpdu) > 0 && !mesh.uvs.empty()) tangent = r.dpdu;
      }
    }
    flip = mesh.flip_normals;
  } else {
    const analytic::UnitPoint unit = analytic::evaluate(placed.analytic.kind, point.u, point.v);
    const Affine3f& m = placed.analytic.object_from_unit;
    r.p = m.point(unit.p);
    r.uv = r.uv1 = {point.u, point.v};
    if (placed.tangents) r.dpdu = m.vector(unit.dpdu), r.dpdv = m.vector(unit.dpdv);
    ns = r.ng = normalize(placed.unit_from_object.transposed_vector(unit.n));
    flip = placed.analytic.flip;
  }
  if (placed.placement == Placement::kInstanced) {
    const Affine3f m = s.world(point.instance, t);
    r.p = m.point(r.p);
    r.ng = transform_normal(m, r.ng);
    ns = transform_normal(m, ns);
    if (placed.tangents) {
      r.dpdu = m.vector(r.dpdu);
      r.dpdv = m.vector(r.dpdv);
      tangent = m.vector(tangent);
    }
  }
  if (flip) {
    r.ng = -r.ng;
    ns = -ns;
  }
  if (placed.tangents) {
    const bool has_tangent = tangent.x != 0 || tangent.y != 0 || tangent.z != 0;
    r.frame = Basis::with_tangent(ns, has_tangent ? tangent : r.dpdu);
    if (tangent_sign < 0) r.frame.t = -r.frame.t;
  } else {
    r.frame = Basis(ns);
  }
  if (scene_->bend_normals) {
    r.bends = true;
    r.unbent = ns;
  }
  return r;
}

SurfaceDerivatives RayScene::derivatives(const SurfacePoint& point, double t) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(point.instance, point.shape);
  SurfaceDerivatives r;
  Vec3f n;  // shading normal, not yet unit; dndu and dndv are its derivatives until the end
  bool flip = false;
  if (placed.mesh) {
    const Impl::Triangle tri = s.triangle(placed, point.primitive, t);
    n = cross(tri.p[1] - tri.p[0], tri.p[2] - tri.p[0]) * (s.mirrored(placed, t) ? -1.0f : 1.0f);
    Vec2f uv[3];
    corner_uvs(*placed.mesh, &placed.mesh->indices[3 * std::size_t(point.primitive)], uv);
    const UvGradient g(uv);
    if (g.usable) {
      r.dpdu = g.du(tri.p), r.dpdv = g.dv(tri.p);
    } else {
      const Basis b(normalize(n));
      r.dpdu = b.s, r.dpdv = b.t;
    }
    if (tri.smooth) {
      n = tri.n[0] * (1 - point.u - point.v) + tri.n[1] * point.u + tri.n[2] * point.v;
      if (g.usable) r.dndu = g.du(tri.n), r.dndv = g.dv(tri.n);
    }
    flip = placed.mesh->flip_normals;
  } else {
    const analytic::UnitPoint unit = analytic::evaluate(placed.analytic.kind, point.u, point.v);
    const Affine3f& m = placed.analytic.object_from_unit;
    const Affine3f& inv = placed.unit_from_object;
    r = {m.vector(unit.dpdu), m.vector(unit.dpdv), inv.transposed_vector(unit.dndu), inv.transposed_vector(unit.dndv)};
    n = inv.transposed_vector(unit.n);
    flip = placed.analytic.flip;
  }
  if (placed.placement == Placement::kInstanced) {
    const Affine3f m = s.world(point.instance, t), inv = inverse(m);
    r = {m.vector(r.dpdu), m.vector(r.dpdv), inv.transposed_vector(r.dndu), inv.transposed_vector(r.dndv)};
    n = inv.transposed_vector(n);
  }
  const float l = length(n);
  if (!(l > 0)) return {r.dpdu, r.dpdv, {}, {}};
  n = n * ((flip ? -1 : 1) / l);
  const auto unit = [&](const Vec3f& dn) { return (dn - n * dot(n, dn)) * ((flip ? -1 : 1) / l); };
  r.dndu = unit(r.dndu);
  r.dndv = unit(r.dndv);
  return r;
}

Vec3f RayScene::position(const SurfacePoint& point, double t, Vec3f* ng) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(point.instance, point.shape);
  Vec3f p, n;
  bool flip = false;
  if (placed.mesh) {
    const Impl::Triangle tri = s.triangle(placed, point.primitive, t);
    p = tri.p[0] * (1 - point.u - point.v) + tri.p[1] * point.u + tri.p[2] * point.v;
    if (ng) n = cross(tri.p[1] - tri.p[0], tri.p[2] - tri.p[0]);
    flip = placed.mesh->flip_normals != s.mirrored(placed, t);
  } else {
    const analytic::UnitPoint unit = analytic::evaluate(placed.analytic.kind, point.u, point.v);
    p = placed.analytic.object_from_unit.point(unit.p);
    n = placed.unit_from_object.transposed_vector(unit.n);
    flip = placed.analytic.flip;
  }
  if (placed.placement == Placement::kInstanced) {
    const Affine3f m = s.world(point.instance, t);
    p = m.point(p);
    if (ng) n = transform_normal(m, n);
  }
  if (ng) *ng = normalize(flip ? -n : n);
  return p;
}

SurfaceMotion RayScene::motion(const SurfacePoint& point, double t) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(point.instance, point.shape);
  const ShadingPoint here = shading_point(point, t, {0, 0, 1});
  SurfaceMotion m{here.p, here.frame.n, {}, {}};
  const auto [knot, blend] = s.locate(t);
  const std::size_t next = std::min(knot + 1, s.pieces.knots().size() - 1);
  const float rate = float(1 / s.pieces.grid().step);
  const auto unit_rate = [](const Vec3f& n, float l, const Vec3f& dn) { return (dn - n * dot(n, dn)) * (1 / l); };
  if (placed.placement == Placement::kDeforming) {
    const Impl::Triangle a = s.knot_triangle(placed, point.primitive, knot);
    const Impl::Triangle b = s.knot_triangle(placed, point.primitive, next);
    const float w[3] = {1 - point.u - point.v, point.u, point.v};
    Vec3f n, dn;
    for (int c = 0; c < 3; ++c) {
      m.dpdt += (b.p[c] - a.p[c]) * (w[c] * rate);
      if (!a.smooth) continue;
      const Vec3f nc = lerp(a.n[c], b.n[c], blend), dc = (b.n[c] - a.n[c]) * rate;
      const float l = length(nc);
      n += nc * (w[c] / l);
      dn += unit_rate(nc * (1 / l), l, dc) * w[c];
    }
    if (!a.smooth) {
      const Vec3f e1 = lerp(a.p[1], b.p[1], blend) - lerp(a.p[0], b.p[0], blend);
      const Vec3f e2 = lerp(a.p[2], b.p[2], blend) - lerp(a.p[0], b.p[0], blend);
      const Vec3f d1 = ((b.p[1] - a.p[1]) - (b.p[0] - a.p[0])) * rate,
                  d2 = ((b.p[2] - a.p[2]) - (b.p[0] - a.p[0])) * rate;
      n = cross(e1, e2);
      dn = cross(d1, e2) + cross(e1, d2);
    }
    const bool flip = placed.mesh->flip_normals != (s.mirrored(placed, t) && !a.smooth);
    const float l = length(n), sign = flip ? -1.0f : 1.0f;
    m.dndt = unit_rate(n * (1 / l), l, dn) * sign;
  } else if (placed.placement == Placement::kInstanced && s.motions[point.instance].moves) {
    const Impl::InstanceMotion& im = s.motions[point.instance];
    const Affine3f w = interpolate(im.knots[knot], im.knots[next], blend);
    const Affine3f dw = interpolate_derivative(im.knots[knot], im.knots[next], blend);
    const Affine3f inv = inverse(w);
    m.dpdt = dw.point(s.object_position(placed, point)) * rate;
    // d(M^-T n) = -M^-T dM^T M^-T n
    const Vec3f dn = -inv.transposed_vector(dw.transposed_vector(here.frame.n)) * rate;
    if (is_finite(dn)) m.dndt = unit_rate(here.frame.n, 1, dn);  // else it is flat, and turns with its plane at most
  }
  return m;
}

float RayScene::triangle_area(std::uint32_t instance, std::uint32_t shape, std::uint32_t primitive, double t) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(instance, shape);
  const Impl::Triangle tri = s.triangle(placed, primitive, t);
  Vec3f e1 = tri.p[1] - tri.p[0], e2 = tri.p[2] - tri.p[0];
  if (placed.placement == Placement::kInstanced) {
    const Affine3f m = s.world(instance, t);
    e1 = m.vector(e1), e2 = m.vector(e2);
  }
  return 0.5f * length(cross(e1, e2));
}

Affine3f RayScene::world_from_unit(std::uint32_t instance, std::uint32_t shape, double t) const {
  const PlacedShape& placed = impl_->find(instance, shape);
  const Affine3f& m = placed.analytic.object_from_unit;
  if (placed.placement != Placement::kInstanced) return m;
  const Affine3f world = impl_->world(instance, t) * m;
  return placed.moving.world ? Affine3f(make_invertible(Affine3d(world))) : world;
}

TimeSpan RayScene::rays() const { return impl_->rays; }
Bounds3f RayScene::bounds() const { return impl_->bounds; }
std::uint64_t RayScene::memory() const {
  return std::uint64_t(std::max<std::int64_t>(0, impl_->cache->bytes.load())) + impl_->cache->vertex_bytes +
         impl_->vertex_bytes;
}

}  // namespace tempera
