// SPDX-License-Identifier: Apache-2.0
#include "geometry_cache.h"

#include <fmt/format.h>

#include <cstring>
#include <set>

#include "motion.h"
#include "tempera/core/error.h"

namespace tempera {

void check_device(RTCDevice device) {
  const RTCError e = rtcGetDeviceError(device);
  if (e == RTC_ERROR_NONE) return;
  if (e == RTC_ERROR_OUT_OF_MEMORY)
    throw Error(ErrorCode::kOutOfMemory, "not enough memory for the ray tracing structures");
  throw Error(ErrorCode::kFailed, fmt::format("ray tracing library reports error {}", int(e)));
}

namespace {

const Mesh* as_mesh(const Shape& s) { return std::get_if<Mesh>(&s.geometry); }

void analytic_bounds(const RTCBoundsFunctionArguments* args) {
  const auto& placed = *static_cast<const PlacedShape*>(args->geometryUserPtr);
  Bounds3f b = placed.moving.bounds;
  if (!placed.moving.world) {
    const Bounds3f unit = analytic::unit_bounds(placed.analytic.kind);
    for (int i = 0; i < 8; ++i) {
      b.extend(placed.analytic.object_from_unit.point(
          {i & 1 ? unit.hi.x : unit.lo.x, i & 2 ? unit.hi.y : unit.lo.y, i & 4 ? unit.hi.z : unit.lo.z}));
    }
  }
  const float pad = 1e-6f * (b.radius() + length(b.center()));  // flat boxes must survive rounding
  *args->bounds_o = {b.lo.x - pad, b.lo.y - pad, b.lo.z - pad, 0, b.hi.x + pad, b.hi.y + pad, b.hi.z + pad, 0};
}

std::optional<analytic::UnitHit> intersect_analytic(const PlacedShape& placed, const RTCRay& ray) {
  Affine3d unit_from_object(placed.unit_from_object);
  if (const auto& moving = placed.moving; moving.world) {
    const Affine3f world = moving.world(moving.begin + double(ray.time) * moving.duration);
    unit_from_object = inverse(make_invertible(Affine3d(world * placed.analytic.object_from_unit)));
  }
  return analytic::intersect(placed.analytic.kind, unit_from_object.point({ray.org_x, ray.org_y, ray.org_z}),
                             unit_from_object.vector({ray.dir_x, ray.dir_y, ray.dir_z}), ray.tnear, ray.tfar);
}

void analytic_intersect(const RTCIntersectFunctionNArguments* args) {
  if (!args->valid[0]) return;  // only single rays are traced
  const auto& placed = *static_cast<const PlacedShape*>(args->geometryUserPtr);
  auto& rayhit = *reinterpret_cast<RTCRayHit*>(args->rayhit);
  const auto hit = intersect_analytic(placed, rayhit.ray);
  if (!hit) return;
  rayhit.ray.tfar = float(hit->t);
  rayhit.hit.u = hit->u;
  rayhit.hit.v = hit->v;
  rayhit.hit.geomID = args->geomID;
  rayhit.hit.primID = args->primID;
  for (unsigned i = 0; i < RTC_MAX_INSTANCE_LEVEL_COUNT; ++i) rayhit.hit.instID[i] = args->context->instID[i];
}

void analytic_occluded(const RTCOccludedFunctionNArguments* args) {
  if (!args->valid[0]) return;
  const auto& placed = *static_cast<const PlacedShape*>(args->geometryUserPtr);
  auto& ray = *reinterpret_cast<RTCRay*>(args->ray);
  if (intersect_analytic(placed, ray)) ray.tfar = -kInfinity;
}

bool is_static_node(const Scene& scene, int node) {
  for (; node >= 0; node = scene.nodes[node].parent) {
    const Node& n = scene.nodes[node];
    if (!n.local.is_constant() || !n.visibility.is_constant()) return false;
  }
  return true;
}

bool is_identity(const Affine3d& m) { return m == Affine3d{}; }

}  // namespace

RTCDevice new_device() {
  // AVX2 beats AVX-512 for single rays, which is what path tracing traces (measured; see docs/performance.md).
  const char* config = nullptr;
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2")) config = "isa=avx2";
#endif
  RTCDevice device = rtcNewDevice(config);
  if (!device) throw Error(ErrorCode::kFailed, "the ray tracing library does not start on this processor");
  return device;
}

GeometryCache::GeometryCache() : impl_(std::make_unique<Impl>()) {
  impl_->device = new_device();
  rtcSetDeviceMemoryMonitorFunction(
      impl_->device,
      [](void* user, ssize_t bytes, bool) {
        *static_cast<std::atomic<std::int64_t>*>(user) += bytes;
        return true;
      },
      &impl_->bytes);
}
GeometryCache::~GeometryCache() {
  impl_->group_scenes.clear();
  impl_->static_scene = {};
  rtcReleaseDevice(impl_->device);
}

/// Attaches one placed shape to an Embree scene; the geometry id is the next free one.
void GeometryCache::Impl::add_geometry(RTCScene target, const PlacedShape& source, RTCBuildQuality quality) const {
  RTCGeometry g = nullptr;
  if (source.mesh) {
    g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    const Mesh& mesh = *source.mesh;
    rtcSetGeometryTimeStepCount(g, unsigned(source.knots.size()));
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, mesh.indices.data(), 0,
                               3 * sizeof(std::uint32_t), mesh.triangle_count());
    for (std::size_t k = 0; k < source.knots.size(); ++k) {
      const KnotVertices& v = source.knots[k];
      // Embree reads 16 bytes at each vertex: an array without spare room behind its end must be copied.
      const bool padded = !v.own_positions.empty() || mesh.positions.capacity() > mesh.positions.size();
      if (padded) {
        rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, unsigned(k), RTC_FORMAT_FLOAT3, v.positions, 0,
                                   sizeof(Vec3f), mesh.positions.size());
      } else {
        void* copy = rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, unsigned(k), RTC_FORMAT_FLOAT3, sizeof(Vec3f),
                                             mesh.positions.size());
        if (copy && !mesh.positions.empty()) std::memcpy(copy, v.positions, sizeof(Vec3f) * mesh.positions.size());
      }
    }
    rtcSetGeometryBuildQuality(g, quality);
  } else {
    g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
    const Affine3f& m = source.analytic.object_from_unit;
    const bool finite = is_finite(m.x) && is_finite(m.y) && is_finite(m.z) && is_finite(m.translation);
    rtcSetGeometryUserPrimitiveCount(g, finite ? 1 : 0);
    rtcSetGeometryUserData(g, const_cast<PlacedShape*>(&source));
    rtcSetGeometryBoundsFunction(
        g, [](const RTCBoundsFunctionArguments* a) { analytic_bounds(a); }, nullptr);
    rtcSetGeometryIntersectFunction(g, analytic_intersect);
    rtcSetGeometryOccludedFunction(g, analytic_occluded);
  }
  rtcCommitGeometry(g);
  rtcAttachGeometry(target, g);
  rtcReleaseGeometry(g);
  check_device(device);
}

namespace {

/// Vertices of `mesh` moved by a constant map; points into the mesh when the map is the identity.
KnotVertices fixed_vertices(const Mesh& mesh, const Affine3d& map, std::uint64_t& bytes) {
  KnotVertices k;
  if (is_identity(map)) {
    k.positions = mesh.positions.data();
    k.normals = mesh.normals.empty() ? nullptr : mesh.normals.data();
    return k;
  }
  k.own_positions.reserve(mesh.positions.size() + 2);
  for (const Vec3f& p : mesh.positions) k.own_positions.push_back(Vec3f(map.point(Vec3d(p))));
  k.own_normals.reserve(mesh.normals.size());
  for (const Vec3f& n : mesh.normals) k.own_normals.push_back(Vec3f(transform_normal(map, Vec3d(n))));
  k.positions = k.own_positions.data();
  k.normals = mesh.normals.empty() ? nullptr : k.own_normals.data();
  bytes += (k.own_positions.capacity() + k.own_normals.capacity()) * sizeof(Vec3f);
  return k;
}

PlacedShape place(const Scene& scene, std::uint32_t instance, std::uint32_t shape, Placement placement,
                  const Affine3d& map, std::uint64_t& bytes) {
  PlacedShape p;
  p.instance = instance;
  p.shape = shape;
  p.placement = placement;
  p.tangents = scene.shapes[shape].material->needs_tangents();
  p.mesh = as_mesh(scene.shapes[shape]);
  if (!p.mesh) {
    p.analytic = std::get<AnalyticShape>(scene.shapes[shape].geometry);
    const Affine3d object_from_unit = make_invertible(map * Affine3d(p.analytic.object_from_unit));
    p.analytic.object_from_unit = Affine3f(object_from_unit);
    p.unit_from_object = Affine3f(inverse(object_from_unit));
  } else if (placement != Placement::kDeforming) {
    p.mirrored = map.determinant() < 0;
    p.knots.push_back(fixed_vertices(*p.mesh, map, bytes));
  }
  if (p.mesh && placement == Placement::kInstanced) {
    const Vec3f* positions = p.knots[0].positions;
    for (const std::uint32_t v : p.mesh->indices) p.box.extend(positions[v]);
    float radius2 = 0;
    for (const std::uint32_t v : p.mesh->indices) {
      radius2 = std::max(radius2, length_squared(positions[v] - p.box.center()));
    }
    p.radius = std::sqrt(radius2);
  }
  return p;
}

}  // namespace

/// Classifies and places everything that does not depend on time, once per scene.
void GeometryCache::Impl::prepare(const Scene& s, bool robust) {
  if (scene == &s) return;
  TEMPERA_ASSERT(scene == nullptr);
  scene = &s;
  for (const Shape& shape : s.shapes) has_opacity |= shape.material->has_opacity();
  std::vector<int> uses(s.groups.size(), 0);
  for (const Instance& i : s.instances) ++uses[i.group];
  static_scene = EmbreeScene(rtcNewScene(device));
  rtcSetSceneBuildQuality(static_scene.scene, RTC_BUILD_QUALITY_HIGH);
  if (robust) rtcSetSceneFlags(static_scene.scene, RTC_SCENE_FLAG_ROBUST);
  std::set<int> instanced_groups;
  for (std::uint32_t i = 0; i < s.instances.size(); ++i) {
    const Instance& instance = s.instances[i];
    const bool fixed = is_static_node(s, instance.node);
    const auto& group = s.groups[instance.group];
    first_placed.push_back(placed.size());
    for (const int shape_index : group) {
      const auto shape = std::uint32_t(shape_index);
      const Mesh* mesh = as_mesh(s.shapes[shape]);
      const Placement placement = mesh && mesh->deforms()              ? Placement::kDeforming
                                  : fixed && uses[instance.group] == 1 ? Placement::kStatic
                                                                       : Placement::kInstanced;
      if (placement == Placement::kInstanced) {
        instanced_groups.insert(instance.group);
        if (!object_shapes.contains(shape)) {
          object_shapes[shape] = std::make_unique<PlacedShape>(place(s, i, shape, placement, Affine3d{}, vertex_bytes));
        }
        placed.push_back(nullptr);
      } else {
        const Affine3d map = placement == Placement::kStatic ? s.world(instance.node, 0) : Affine3d{};
        placed.push_back(std::make_unique<PlacedShape>(place(s, i, shape, placement, map, vertex_bytes)));
      }
      placements.push_back(placement);
      anything_moves |= placement != Placement::kStatic;
      if (placement == Placement::kStatic && s.visible(instance.node, 0)) {
        static_ids.push_back(placed.back().get());
        add_geometry(static_scene.scene, *placed.back(), RTC_BUILD_QUALITY_HIGH);
      }
    }
  }
  rtcCommitScene(static_scene.scene);
  check_device(device);
  for (const int g : instanced_groups) {
    EmbreeScene group(rtcNewScene(device));
    rtcSetSceneBuildQuality(group.scene, RTC_BUILD_QUALITY_HIGH);
    if (robust) rtcSetSceneFlags(group.scene, RTC_SCENE_FLAG_ROBUST);
    for (const int shape : s.groups[g]) {
      // Deforming shapes of the same group are attached to the top scene; an empty geometry keeps the ids aligned.
      const auto it = object_shapes.find(std::uint32_t(shape));
      if (it != object_shapes.end()) {
        add_geometry(group.scene, *it->second, RTC_BUILD_QUALITY_HIGH);
      } else {
        RTCGeometry empty = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
        rtcCommitGeometry(empty);
        rtcAttachGeometry(group.scene, empty);
        rtcReleaseGeometry(empty);
      }
    }
    rtcCommitScene(group.scene);
    check_device(device);
    group_scenes.emplace(g, std::move(group));
  }
}

}  // namespace tempera
