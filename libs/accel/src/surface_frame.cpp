// SPDX-License-Identifier: Apache-2.0
// Surfaces in double: their differentials, and where lines cross them.
#include <array>
#include <bit>

#include "ray_scene_impl.h"

namespace tempera {

namespace {

/// A normal of any length and its derivatives.
struct Normal {
  Vec3d n, du, dv, dt;

  Normal mapped(const MovingAffine& m) const {
    const Affine3d &map = m.map, &rate = m.rate;
    const auto crossed = [&](const Vec3d& v) {  // derivative by time of cofactor_vector(map, v)
      return (cross(rate.y, map.z) + cross(map.y, rate.z)) * v.x + (cross(rate.z, map.x) + cross(map.z, rate.x)) * v.y +
             (cross(rate.x, map.y) + cross(map.x, rate.y)) * v.z;
    };
    Normal r{cofactor_vector(map, n), cofactor_vector(map, du), cofactor_vector(map, dv),
             cofactor_vector(map, dt) + crossed(n)};
    return map.determinant() < 0 ? r.times(-1) : r;
  }
  Normal times(double s) const { return {n * s, du * s, dv * s, dt * s}; }
  Normal unit() const {
    const double l = length(n);
    if (!(l > 0)) return {};
    const Vec3d e = n * (1 / l);
    const auto turned = [&](const Vec3d& d) { return (d - e * dot(e, d)) * (1 / l); };
    return {e, turned(du), turned(dv), turned(dt)};
  }
};

constexpr double kRangeSlack = 1e-4, kSpaceSlack = 2e-6;

}  // namespace

struct PoseCache::Impl {
  struct Pose {
    const void* rays = nullptr;  ///< null: empty
    std::uint32_t instance = 0;
    double time = 0;
    MovingAffine world;
  };
  std::array<Pose, 64> poses;
  Pose& place_of(std::uint32_t instance, double t) {
    const std::uint64_t bits = (std::bit_cast<std::uint64_t>(t) + instance) * 0x9e3779b97f4a7c15u;
    return poses[bits >> 58];
  }
};

PoseCache::PoseCache() : impl_(std::make_unique<Impl>()) {}
PoseCache::~PoseCache() = default;

/// Never inlined: its products would be contracted with sums elsewhere, and a map that is kept would have other bits.
[[gnu::noinline]] MovingAffine RayScene::Impl::moving_world(std::uint32_t instance, double t) const {
  const InstanceMotion& motion = motions[instance];
  constexpr Affine3d kNone{{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
  if (!motion.moves) return {Affine3d(motion.world), kNone};
  const auto [knot, next, blend] = pieces.segment(t);
  MovingAffine m = interpolate_moving(motion.knots[knot], motion.knots[next], blend);
  const double per_second = 1 / pieces.grid().step;
  for (Vec3d* v : {&m.rate.x, &m.rate.y, &m.rate.z, &m.rate.translation}) *v *= per_second;
  return m;
}

MovingAffine RayScene::Impl::moving_world(std::uint32_t instance, double t, PoseCache* poses) const {
  if (!poses || !motions[instance].moves) return moving_world(instance, t);
  PoseCache::Impl::Pose& pose = poses->impl_->place_of(instance, t);
  if (pose.rays != this || pose.instance != instance || pose.time != t)
    pose = {this, instance, t, moving_world(instance, t)};
  return pose.world;
}

RayScene::Impl::MovingTriangle RayScene::Impl::moving_triangle(const PlacedShape& p, std::uint32_t primitive,
                                                               double t) const {
  MovingTriangle r;
  if (p.placement != Placement::kDeforming) {
    const Triangle still = knot_triangle(p, primitive, 0);
    for (int c = 0; c < 3; ++c) r.p[c] = Vec3d(still.p[c]), r.n[c] = Vec3d(still.n[c]);
    r.smooth = still.smooth;
    return r;
  }
  const auto [knot, next, blend] = pieces.segment(t);
  const Triangle a = knot_triangle(p, primitive, knot), b = knot_triangle(p, primitive, next);
  const double per_second = 1 / pieces.grid().step;
  r.smooth = a.smooth;
  for (int c = 0; c < 3; ++c) {
    const Vec3d change = Vec3d(b.p[c]) - Vec3d(a.p[c]);
    r.p[c] = Vec3d(a.p[c]) + change * blend;
    r.dpdt[c] = change * per_second;
    if (!r.smooth) continue;
    const Vec3d turn = Vec3d(b.n[c]) - Vec3d(a.n[c]);
    const Normal n = Normal{Vec3d(a.n[c]) + turn * blend, {}, {}, turn * per_second}.unit();
    r.n[c] = n.n;
    r.dndt[c] = n.dt;
  }
  return r;
}

SurfaceFrame RayScene::surface(const SurfacePoint& point, double u, double v, double t, PoseCache* poses) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(point.instance, point.shape);
  SurfaceFrame r;
  Normal ng, n;
  bool smooth = false, flip = false;
  if (placed.mesh) {
    const Impl::MovingTriangle tri = s.moving_triangle(placed, point.primitive, t);
    const auto interpolated = [&](const Vec3d(&x)[3]) { return x[0] * (1 - u - v) + x[1] * u + x[2] * v; };
    r.p = interpolated(tri.p);
    r.dpdt = interpolated(tri.dpdt);
    r.dpdu = tri.p[1] - tri.p[0], r.dpdv = tri.p[2] - tri.p[0];
    const Vec3d d1 = tri.dpdt[1] - tri.dpdt[0], d2 = tri.dpdt[2] - tri.dpdt[0];
    ng = {cross(r.dpdu, r.dpdv), {}, {}, cross(d1, r.dpdv) + cross(r.dpdu, d2)};
    if (s.mirrored(placed, t)) ng = ng.times(-1);
    smooth = tri.smooth;
    if (smooth) n = {interpolated(tri.n), tri.n[1] - tri.n[0], tri.n[2] - tri.n[0], interpolated(tri.dndt)};
    flip = placed.mesh->flip_normals;
  } else {
    const analytic::UnitPoint<double> unit = analytic::evaluate(placed.analytic.kind, u, v);
    const Affine3d m(placed.analytic.object_from_unit);
    r.p = m.point(unit.p);
    r.dpdu = m.vector(unit.dpdu), r.dpdv = m.vector(unit.dpdv);
    ng = Normal{unit.n, unit.dndu, unit.dndv, {}}.mapped({m, {{}, {}, {}, {}}});
    flip = placed.analytic.flip_normals;
  }
  if (placed.placement == Placement::kInstanced) {
    const MovingAffine m = s.moving_world(point.instance, t, poses);
    r.dpdt = m.map.vector(r.dpdt) + m.rate.point(r.p);
    r.p = m.map.point(r.p);
    r.dpdu = m.map.vector(r.dpdu), r.dpdv = m.map.vector(r.dpdv);
    ng = ng.mapped(m);
    n = n.mapped(m);
  }
  if (const double area2 = dot(ng.n, ng.n); area2 > 0) r.area_rate = dot(ng.n, ng.dt) / area2;
  ng = ng.unit();
  n = n.unit();
  if (!smooth || n.n == Vec3d{}) n = ng;
  const double side = flip ? -1 : 1;
  r.ng = ng.n * side, r.dngdt = ng.dt * side;
  r.n = n.n * side, r.dndu = n.du * side, r.dndv = n.dv * side, r.dndt = n.dt * side;
  return r;
}

std::optional<PrimitiveHit> RayScene::refine(const Hit& hit, const Vec3d& o, const Vec3d& d, double t,
                                             PoseCache* poses) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(hit.point.instance, hit.point.shape);
  Affine3d map;
  if (placed.placement == Placement::kInstanced) map = s.moving_world(hit.point.instance, t, poses).map;
  const auto magnitude = [](const Vec3d& v) { return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}); };
  const auto slack = [&](const Vec3d& p, double per_metre) {
    return kRangeSlack + kSpaceSlack * (magnitude(o) + magnitude(p)) * per_metre;
  };
  // Corrects a hit by where the surface around it crosses the line; the next one is better wherever that is defined.
  const auto improve = [&](PrimitiveHit& h, const Vec3d& p, const Vec3d& dpdu, const Vec3d& dpdv) {
    const Affine3d inv = inverse(Affine3d{dpdu, dpdv, -d});
    const Vec3d step = inv.vector(o + d * h.distance - p);
    if (!is_finite(step)) return false;
    h = {h.u + step.x, h.v + step.y, h.distance + step.z};
    return true;
  };
  PrimitiveHit h;
  if (placed.mesh) {
    const Impl::MovingTriangle tri = s.moving_triangle(placed, hit.point.primitive, t);
    const Vec3d p0 = map.point(tri.p[0]), e1 = map.point(tri.p[1]) - p0, e2 = map.point(tri.p[2]) - p0;
    for (int i = 0; i < 2; ++i) {  // the second time against rounding
      if (!improve(h, p0 + e1 * h.u + e2 * h.v, e1, e2)) return std::nullopt;
    }
    // How fast a barycentric changes across the triangle: one over its height.
    const double area = length(cross(e1, e2));
    const double eps = slack(p0, std::max({length(e1), length(e2), length(e2 - e1)}) / area);
    if (!(h.u >= -eps && h.v >= -eps && h.u + h.v <= 1 + eps)) return std::nullopt;
    return h;
  }
  map = map * Affine3d(placed.analytic.object_from_unit);
  const Affine3d unit_from_world = inverse(placed.moving.world ? make_invertible(map) : map);
  const auto kind = placed.analytic.kind;
  const auto line = analytic::cross_line(kind, unit_from_world.point(o), unit_from_world.vector(d), double(hit.t));
  if (!line) return std::nullopt;
  h = {line->u, line->v, line->t};
  const auto error = [&](const PrimitiveHit& at) {
    return length(map.point(analytic::evaluate(kind, at.u, at.v).p) - (o + d * at.distance));
  };
  // What is flat was crossed with a thickness, and the inverse of what is nearly flat has lost digits.
  double residual = error(h);
  for (int i = 0; i < 4; ++i) {
    PrimitiveHit better = h;
    const analytic::UnitPoint<double> at = analytic::evaluate(kind, h.u, h.v);
    if (!improve(better, map.point(at.p), map.vector(at.dpdu), map.vector(at.dpdv))) break;
    const double left = error(better);
    if (!(left < residual)) break;
    h = better, residual = left;
  }
  const Vec3d p = o + d * h.distance;
  const Affine3d& inv = unit_from_world;
  const double eps = slack(p, std::sqrt(length_squared(inv.x) + length_squared(inv.y) + length_squared(inv.z)));
  if (kind == AnalyticKind::kDisk && !(h.u <= 1 + eps)) return std::nullopt;
  if (kind == AnalyticKind::kCylinder && !(h.v >= -eps && h.v <= 1 + eps)) return std::nullopt;
  double& turn = kind == AnalyticKind::kDisk ? h.v : h.u;
  turn -= std::floor(turn);
  return h;
}

}  // namespace tempera
