// SPDX-License-Identifier: Apache-2.0
#include "tempera/accel/ray_scene.h"

#include <embree3/rtcore.h>
#include <fmt/format.h>

#include "geometry_cache.h"
#include "motion.h"
#include "tempera/core/error.h"
#include "tempera/core/parallel.h"

namespace tempera {

constexpr std::int64_t kMaxSegments = 128;  // Embree: at most 129 time steps per geometry

struct RayScene::Impl {
  const Scene* scene = nullptr;
  GeometryCache::Impl* cache = nullptr;
  TimeSpan rays, evaluation;
  MotionGrid grid;
  std::int64_t first_knot = 0, last_knot = 0;  // of the ray span
  double ray_begin = 0, ray_scale = 0;         // Embree's time = (t - ray_begin) * ray_scale
  RTCScene top = nullptr;                      // own_top, or the static scene itself
  EmbreeScene own_top;
  bool top_is_static = false;
  Bounds3f bounds;
  float resampling_error = 0;
  std::uint64_t vertex_bytes = 0;

  /// What an Embree id of the top scene stands for.
  struct TopEntry {
    enum Kind : std::uint8_t { kStaticScene, kInstance, kShape } kind = kStaticScene;
    std::uint32_t instance = 0;
    std::uint32_t shape = 0;
  };
  std::vector<TopEntry> top_entries;

  /// Instanced motion: knots over the evaluation span, or one constant map.
  struct InstanceMotion {
    bool moves = false;
    std::int64_t first = 0;
    std::vector<AffineKnot> knots;
    Affine3f world;
  };
  std::vector<InstanceMotion> motions;                  // by instance; used for instanced placement only
  std::vector<std::unique_ptr<PlacedShape>> deforming;  // own copies with this span's vertices
  std::vector<const PlacedShape*> placed;               // like cache->placed, deforming ones replaced

  std::vector<const PlacedShape*> only;  // by instance: its one shape, or null for groups of several

  const PlacedShape& find(std::uint32_t instance, std::uint32_t shape) const {
    if (const PlacedShape* p = only[instance]) return *p;
    const auto& group = scene->groups[std::size_t(scene->instances[instance].group)];
    std::size_t i = cache->first_placed[instance];
    for (std::size_t k = 0; std::uint32_t(group[k]) != shape; ++k) ++i;
    return *placed[i];
  }
  float embree_time(double t) const { return float(std::clamp((t - ray_begin) * ray_scale, 0.0, 1.0)); }

  void build_motions();
  void build_deforming(PlacedShape& shape);
  void measure_error(const PlacedShape& shape);
  Affine3f world(std::uint32_t instance, double t) const;
  struct Triangle {
    Vec3f p[3], n[3];
    bool smooth = false;
  };
  /// Vertices of a mesh's triangle at time t in the frame that Embree sees (world, or object for instanced ones).
  Triangle triangle(const PlacedShape& placed, std::uint32_t primitive, double t) const;
  Triangle blended_triangle(const PlacedShape& placed, std::uint32_t primitive, double t) const;
  Triangle knot_triangle(const PlacedShape& placed, std::uint32_t primitive, std::int64_t knot) const;
};

void RayScene::Impl::build_motions() {
  motions.resize(scene->instances.size());
  const std::int64_t e0 = grid.first(evaluation), e1 = grid.last(evaluation);
  for (std::size_t i = 0; i < motions.size(); ++i) {
    const Instance& instance = scene->instances[i];
    InstanceMotion& m = motions[i];
    m.world = Affine3f(scene->world(instance.node, grid.time(first_knot)));
    m.moves = scene->moves(instance.node, {grid.time(e0), grid.time(e1)});
    if (!m.moves) continue;
    m.first = e0;
    for (std::int64_t k = e0; k <= e1; ++k) {
      m.knots.push_back(decompose(scene->world(instance.node, grid.time(k))));
      if (k > e0) {  // neighbours in one hemisphere: slerp then takes the short way everywhere
        Quatf& q = m.knots.back().q;
        if (dot(q, m.knots[m.knots.size() - 2].q) < 0) q = -q;
      }
    }
  }
}

Affine3f RayScene::Impl::world(std::uint32_t instance, double t) const {
  const InstanceMotion& m = motions[instance];
  if (!m.moves) return m.world;
  const auto [knot, blend] = grid.locate(t);
  const std::int64_t i = std::clamp<std::int64_t>(knot - m.first, 0, std::int64_t(m.knots.size()) - 1);
  if (blend == 0 || i + 1 >= std::int64_t(m.knots.size())) return compose(m.knots[std::size_t(i)]);
  return interpolate(m.knots[std::size_t(i)], m.knots[std::size_t(i) + 1], blend);
}

void RayScene::Impl::build_deforming(PlacedShape& placed_shape) {
  const Mesh& mesh = *placed_shape.mesh;
  const int node = scene->instances[placed_shape.instance].node;
  const std::int64_t e0 = grid.first(evaluation), e1 = grid.last(evaluation);
  placed_shape.first_pose = e0;
  placed_shape.first_knot = first_knot;
  for (std::int64_t k = e0; k <= e1; ++k) {
    placed_shape.poses.push_back(mesh_pose(*scene, mesh, node, grid.time(k)));
    placed_shape.pose_world.emplace_back(scene->world(node, grid.time(k)));
  }
  for (std::int64_t k = first_knot; k <= last_knot; ++k) {
    const MeshPose& pose = placed_shape.poses[std::size_t(k - e0)];
    const Affine3f world = placed_shape.pose_world[std::size_t(k - e0)];
    const Affine3f inv = inverse(world);
    KnotVertices v;
    v.own_positions.reserve(mesh.positions.size() + 2);
    v.own_positions.resize(mesh.positions.size());
    v.own_normals.resize(mesh.normals.size());
    constexpr std::int64_t kBlock = 4096;
    const auto n = std::int64_t(mesh.positions.size());
    parallel_for(0, (n + kBlock - 1) / kBlock, [&](std::int64_t block) {
      for (std::int64_t i = block * kBlock; i < std::min(n, (block + 1) * kBlock); ++i) {
        v.own_positions[std::size_t(i)] = world.point(posed_position(mesh, pose, std::uint32_t(i)));
        if (!mesh.normals.empty()) {
          v.own_normals[std::size_t(i)] = normalize(inv.transposed_vector(posed_normal(mesh, pose, std::uint32_t(i))));
        }
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
                                                       std::int64_t knot) const {
  Triangle t;
  const Mesh& mesh = *p.mesh;
  t.smooth = !mesh.normals.empty();
  const std::int64_t stored = p.placement == Placement::kDeforming ? knot - p.first_knot : 0;
  const bool in_memory = stored >= 0 && stored < std::int64_t(p.knots.size());
  for (int c = 0; c < 3; ++c) {
    const std::uint32_t v = mesh.indices[3 * std::size_t(primitive) + std::size_t(c)];
    if (in_memory) {
      const KnotVertices& k = p.knots[std::size_t(stored)];
      t.p[c] = k.positions[v];
      if (t.smooth) t.n[c] = k.normals[v];
    } else {  // outside the span of rays: the same function that filled the buffers, for three vertices
      const auto i = std::size_t(std::clamp<std::int64_t>(knot - p.first_pose, 0, std::int64_t(p.poses.size()) - 1));
      t.p[c] = p.pose_world[i].point(posed_position(mesh, p.poses[i], v));
      if (t.smooth) t.n[c] = normalize(inverse(p.pose_world[i]).transposed_vector(posed_normal(mesh, p.poses[i], v)));
    }
  }
  return t;
}

RayScene::Impl::Triangle RayScene::Impl::blended_triangle(const PlacedShape& p, std::uint32_t primitive,
                                                          double time) const {
  const auto [knot, blend] = grid.locate(time);
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

/// Compares the resampled motion with the scene's own midway between knots of the ray span.
void RayScene::Impl::measure_error(const PlacedShape& shape) {
  if (last_knot == first_knot) return;
  const int node = scene->instances[shape.instance].node;
  for (std::int64_t k = first_knot; k < last_knot; ++k) {
    const double t = grid.time(k) + 0.5 * grid.step;
    const Affine3f exact(scene->world(node, t));
    if (shape.placement == Placement::kDeforming) {
      const Mesh& mesh = *shape.mesh;
      const MeshPose pose = mesh_pose(*scene, mesh, node, t);
      const std::size_t n = mesh.positions.size(), stride = std::max<std::size_t>(1, n / 64);
      const auto& a = shape.knots[std::size_t(k - first_knot)];
      const auto& b = shape.knots[std::size_t(k - first_knot) + 1];
      for (std::size_t v = 0; v < n; v += stride) {
        const Vec3f p = exact.point(posed_position(mesh, pose, std::uint32_t(v)));
        resampling_error = std::max(resampling_error, length(p - lerp(a.positions[v], b.positions[v], 0.5f)));
      }
    }
  }
}

RayScene::RayScene(const Scene& scene, TimeSpan rays, TimeSpan evaluation, const RaySceneOptions& options,
                   GeometryCache& cache)
    : impl_(std::make_unique<Impl>()), scene_(&scene) {
  Impl& s = *impl_;
  s.scene = &scene;
  s.cache = cache.impl_.get();
  s.cache->prepare(scene, options.robust);
  s.rays = rays;
  s.evaluation = {std::min(evaluation.begin, rays.begin), std::max(evaluation.end, rays.end)};
  s.grid.step = options.motion_step;
  s.first_knot = s.grid.first(rays);
  s.last_knot = std::max(s.grid.last(rays), s.first_knot);
  if (s.last_knot - s.first_knot > kMaxSegments) {
    throw Error(
        ErrorCode::kOutOfRange,
        fmt::format("{} motion segments between {} s and {} s; at most {} fit one ray scene: use a shorter span or "
                    "fewer motion segments a frame",
                    s.last_knot - s.first_knot, rays.begin, rays.end, kMaxSegments));
  }
  s.ray_begin = s.grid.time(s.first_knot);
  s.ray_scale = s.last_knot > s.first_knot ? 1.0 / (double(s.last_knot - s.first_knot) * s.grid.step) : 0;
  s.build_motions();

  for (const auto& p : s.cache->placed) s.placed.push_back(p.get());
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const auto& group = scene.groups[std::size_t(scene.instances[i].group)];
    for (std::size_t k = 0; k < group.size(); ++k) {
      const std::size_t slot = s.cache->first_placed[i] + k;
      if (!s.placed[slot]) s.placed[slot] = s.cache->object_shapes.at(std::uint32_t(group[k])).get();
    }
  }
  const double representative = 0.5 * (rays.begin + rays.end);
  if (!s.cache->anything_moves) {
    s.top = s.cache->static_scene.scene;
    s.top_is_static = true;
  } else {
    s.own_top = EmbreeScene(rtcNewScene(s.cache->device));
    s.top = s.own_top.scene;
    rtcSetSceneBuildQuality(s.top, RTC_BUILD_QUALITY_MEDIUM);
    if (options.robust) rtcSetSceneFlags(s.top, RTC_SCENE_FLAG_ROBUST);
    if (!s.cache->static_ids.empty()) {
      RTCGeometry g = rtcNewGeometry(s.cache->device, RTC_GEOMETRY_TYPE_INSTANCE);
      rtcSetGeometryInstancedScene(g, s.cache->static_scene.scene);
      rtcCommitGeometry(g);
      rtcAttachGeometry(s.top, g);
      rtcReleaseGeometry(g);
      s.top_entries.push_back({Impl::TopEntry::kStaticScene, 0, 0});
    }
    for (std::uint32_t i = 0; i < scene.instances.size(); ++i) {
      const Instance& instance = scene.instances[i];
      const auto& group = scene.groups[std::size_t(instance.group)];
      const bool visible = scene.visible(instance.node, representative);
      bool instanced = false;
      for (std::size_t k = 0; k < group.size(); ++k) {
        const std::size_t slot = s.cache->first_placed[i] + k;
        instanced |= s.cache->placements[slot] == Placement::kInstanced;
        if (s.cache->placements[slot] != Placement::kDeforming) continue;
        auto own = std::make_unique<PlacedShape>(PlacedShape(*s.cache->placed[slot]));
        s.build_deforming(*own);
        s.measure_error(*own);
        s.placed[slot] = own.get();
        if (visible) {
          s.cache->add_geometry(s.top, *own, RTC_BUILD_QUALITY_MEDIUM);
          s.top_entries.push_back({Impl::TopEntry::kShape, i, own->shape});
        }
        s.deforming.push_back(std::move(own));
      }
      if (!instanced || !visible) continue;
      RTCGeometry g = rtcNewGeometry(s.cache->device, RTC_GEOMETRY_TYPE_INSTANCE);
      rtcSetGeometryInstancedScene(g, s.cache->group_scenes.at(instance.group).scene);
      const Impl::InstanceMotion& m = s.motions[i];
      if (!m.moves || s.last_knot == s.first_knot) {
        const Affine3f w = s.world(i, s.ray_begin);
        rtcSetGeometryTransform(g, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, &w);
      } else {
        const auto first = std::size_t(s.first_knot - m.first), count = std::size_t(s.last_knot - s.first_knot + 1);
        rtcSetGeometryTimeStepCount(g, unsigned(count));
        for (std::size_t k = 0; k < count; ++k) {
          const AffineKnot& knot = m.knots[first + k];
          RTCQuaternionDecomposition q;
          rtcInitQuaternionDecomposition(&q);
          rtcQuaternionDecompositionSetQuaternion(&q, knot.q.w, knot.q.x, knot.q.y, knot.q.z);
          rtcQuaternionDecompositionSetScale(&q, knot.scale.x, knot.scale.y, knot.scale.z);
          rtcQuaternionDecompositionSetSkew(&q, knot.skew.x, knot.skew.y, knot.skew.z);
          rtcQuaternionDecompositionSetTranslation(&q, knot.translation.x, knot.translation.y, knot.translation.z);
          rtcSetGeometryTransformQuaternion(g, unsigned(k), &q);
        }
        Bounds3f box;  // rigid motion: corners of the group's box against the exact pose
        RTCBounds b;
        rtcGetSceneBounds(s.cache->group_scenes.at(instance.group).scene, &b);
        for (std::int64_t k = s.first_knot; k < s.last_knot; ++k) {
          const double t = s.grid.time(k) + 0.5 * s.grid.step;
          const Affine3f exact(scene.world(instance.node, t)), ours = s.world(i, t);
          for (int c = 0; c < 8; ++c) {
            const Vec3f p{c & 1 ? b.upper_x : b.lower_x, c & 2 ? b.upper_y : b.lower_y, c & 4 ? b.upper_z : b.lower_z};
            s.resampling_error = std::max(s.resampling_error, length(exact.point(p) - ours.point(p)));
          }
        }
      }
      rtcCommitGeometry(g);
      rtcAttachGeometry(s.top, g);
      rtcReleaseGeometry(g);
      s.top_entries.push_back({Impl::TopEntry::kInstance, i, 0});
    }
    rtcCommitScene(s.top);
  }
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const bool single = scene.groups[std::size_t(scene.instances[i].group)].size() == 1;
    s.only.push_back(single ? s.placed[s.cache->first_placed[i]] : nullptr);
  }
  check_device(s.cache->device);
  RTCBounds b;
  rtcGetSceneBounds(s.top, &b);
  if (b.lower_x <= b.upper_x) s.bounds = {{b.lower_x, b.lower_y, b.lower_z}, {b.upper_x, b.upper_y, b.upper_z}};
  smallest_offset_ = 1e-6f * s.bounds.radius();
  has_opacity_ = s.cache->has_opacity;
}

RayScene::~RayScene() = default;
RayScene::RayScene(RayScene&&) noexcept = default;

namespace {

/// What Embree traces. Others would end the program where it was built with assertions, as Debian's is.
bool is_traceable(const Ray& r) {
  constexpr float kLargest = 1e18f;
  const float sum =
      std::abs(r.o.x) + std::abs(r.o.y) + std::abs(r.o.z) + std::abs(r.d.x) + std::abs(r.d.y) + std::abs(r.d.z);
  return sum <= kLargest && r.tmin <= r.tmax;  // false for what is no number
}

}  // namespace

std::optional<Hit> RayScene::intersect(const Ray& ray) const {
  std::optional<Hit> hit(std::in_place);
  if (!intersect(ray, *hit)) hit.reset();
  return hit;
}

bool RayScene::intersect(const Ray& ray, Hit& hit) const {
  if (!is_traceable(ray)) return false;
  const Impl& s = *impl_;
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
  if (!is_traceable(ray)) return false;
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
    r.ng = normalize(cross(tri.p[1] - tri.p[0], tri.p[2] - tri.p[0]) * (placed.mirrored ? -1.0f : 1.0f));
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
    const Affine3f inv = inverse(m);
    r.p = m.point(r.p);
    r.ng = normalize(inv.transposed_vector(r.ng));
    ns = normalize(inv.transposed_vector(ns));
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
    n = cross(tri.p[1] - tri.p[0], tri.p[2] - tri.p[0]) * (placed.mirrored ? -1.0f : 1.0f);
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
    flip = placed.mesh->flip_normals != placed.mirrored;
  } else {
    const analytic::UnitPoint unit = analytic::evaluate(placed.analytic.kind, point.u, point.v);
    p = placed.analytic.object_from_unit.point(unit.p);
    n = placed.unit_from_object.transposed_vector(unit.n);
    flip = placed.analytic.flip;
  }
  if (placed.placement == Placement::kInstanced) {
    const Affine3f m = s.world(point.instance, t);
    p = m.point(p);
    if (ng) n = inverse(m).transposed_vector(n);
  }
  if (ng) *ng = normalize(flip ? -n : n);
  return p;
}

SurfaceMotion RayScene::motion(const SurfacePoint& point, double t) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(point.instance, point.shape);
  const ShadingPoint here = shading_point(point, t, {0, 0, 1});
  SurfaceMotion m{here.p, here.frame.n, {}, {}};
  const auto [knot, blend] = s.grid.locate(t);
  const float rate = float(1 / s.grid.step);
  const auto unit_rate = [](const Vec3f& n, float l, const Vec3f& dn) { return (dn - n * dot(n, dn)) * (1 / l); };
  if (placed.placement == Placement::kDeforming) {
    const Impl::Triangle a = s.knot_triangle(placed, point.primitive, knot);
    const Impl::Triangle b = s.knot_triangle(placed, point.primitive, knot + 1);
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
    const bool flip = placed.mesh->flip_normals != (placed.mirrored && !a.smooth);
    const float l = length(n), sign = flip ? -1.0f : 1.0f;
    m.dndt = unit_rate(n * (1 / l), l, dn) * sign;
  } else if (placed.placement == Placement::kInstanced && s.motions[point.instance].moves) {
    const Impl::InstanceMotion& im = s.motions[point.instance];
    const auto i = std::size_t(std::clamp<std::int64_t>(knot - im.first, 0, std::int64_t(im.knots.size()) - 2));
    const Affine3f w = interpolate(im.knots[i], im.knots[i + 1], blend);
    const Affine3f dw = interpolate_derivative(im.knots[i], im.knots[i + 1], blend);
    const Affine3f inv = inverse(w);
    m.dpdt = dw.point(inv.point(here.p)) * rate;
    // d(M^-T n) = -M^-T dM^T M^-T n
    const Vec3f dn = -inv.transposed_vector(dw.transposed_vector(here.frame.n)) * rate;
    m.dndt = unit_rate(here.frame.n, 1, dn);
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

Affine3f RayScene::world_from_object(std::uint32_t instance, std::uint32_t shape, double t) const {
  const PlacedShape& placed = impl_->find(instance, shape);
  return placed.placement == Placement::kInstanced ? impl_->world(instance, t) : Affine3f{};
}

TimeSpan RayScene::rays() const { return impl_->rays; }
Bounds3f RayScene::bounds() const { return impl_->bounds; }
float RayScene::resampling_error() const { return impl_->resampling_error; }
std::uint64_t RayScene::memory() const {
  return std::uint64_t(std::max<std::int64_t>(0, impl_->cache->bytes.load())) + impl_->cache->vertex_bytes +
         impl_->vertex_bytes;
}

}  // namespace tempera
