// SPDX-License-Identifier: Apache-2.0
// From a scene to what Embree traces, motion included.
#include <embree3/rtcore.h>
#include <fmt/format.h>

#include "ray_scene_impl.h"
#include "tempera/core/error.h"
#include "tempera/core/parallel.h"

namespace tempera {

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
        v.own_positions[i] = posed_position(mesh, pose, std::uint32_t(i));
        if (!mesh.normals.empty()) v.own_normals[i] = posed_normal(mesh, pose, std::uint32_t(i));
      }
    });
    vertex_bytes += (v.own_positions.capacity() + v.own_normals.capacity()) * sizeof(Vec3f);
    placed_shape.knots.push_back(std::move(v));
    KnotVertices& stored = placed_shape.knots.back();
    stored.positions = stored.own_positions.data();
    stored.normals = mesh.normals.empty() ? nullptr : stored.own_normals.data();
  }
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
  const auto& group = scene->groups[instance.group];
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
    const auto& group = scene.groups[scene.instances[i].group];
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
    const bool single = scene.groups[scene.instances[i].group].size() == 1;
    s.single_shape.push_back(single ? s.placed[s.cache->first_placed[i]] : nullptr);
  }
  check_device(s.cache->device);
  s.bounds = bounds_of(s.top);
  smallest_offset_ = 1e-6f * s.bounds.radius();
  has_opacity_ = s.cache->has_opacity;
}

RayScene::~RayScene() = default;
RayScene::RayScene(RayScene&&) noexcept = default;

TimeSpan RayScene::rays() const { return impl_->rays; }
Bounds3f RayScene::bounds() const { return impl_->bounds; }
std::uint64_t RayScene::memory() const {
  return std::uint64_t(std::max<std::int64_t>(0, impl_->cache->bytes.load())) + impl_->cache->vertex_bytes +
         impl_->vertex_bytes;
}

}  // namespace tempera
