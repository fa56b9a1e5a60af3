// SPDX-License-Identifier: Apache-2.0
// What moves within a span of time, and where it passes.
#include "ray_scene_impl.h"
#include "tempera/core/parallel.h"

namespace tempera {

namespace {

/// Room for the rounding of what is traced.
Bounds3f padded(const Bounds3f& b) {
  if (b.empty()) return b;
  float largest = 0;
  for (int i = 0; i < 3; ++i) largest = std::max({largest, std::abs(b.lo[i]), std::abs(b.hi[i])});
  const float pad = 4e-6f * largest + 4e-6f * b.radius() + std::numeric_limits<float>::min();
  return {b.lo - Vec3f{pad, pad, pad}, b.hi + Vec3f{pad, pad, pad}};
}

Vec3f corner(const Bounds3f& b, int i) {
  return {i & 1 ? b.hi.x : b.lo.x, i & 2 ? b.hi.y : b.lo.y, i & 4 ? b.hi.z : b.lo.z};
}

/// Box of an analytic shape or an instanced mesh under a map of the space that Embree sees it in.
Bounds3f bounds_under(const PlacedShape& placed, const Affine3d& map) {
  if (!placed.mesh) return analytic::bounds(placed.analytic.kind, map * Affine3d(placed.analytic.object_from_unit));
  if (placed.box.empty()) return {};
  // Both the box and the ball around the mesh, mapped, hold it.
  const Vec3d center = map.point(Vec3d(placed.box.center())), half = Vec3d(placed.box.hi - placed.box.lo) * 0.5;
  Vec3d reach;
  for (int i = 0; i < 3; ++i) {
    const Vec3d row{map.x[i], map.y[i], map.z[i]};
    const double by_box = std::abs(row.x) * half.x + std::abs(row.y) * half.y + std::abs(row.z) * half.z;
    reach[i] = std::min(by_box, length(row) * double(placed.radius));
  }
  return {Vec3f(center - reach), Vec3f(center + reach)};
}

}  // namespace

const Vec3f* RayScene::Impl::positions_at(const PlacedShape& p, std::size_t knot, std::vector<Vec3f>& storage) const {
  if (knot >= p.first_knot && knot - p.first_knot < p.knots.size()) return p.knots[knot - p.first_knot].positions;
  storage.resize(p.mesh->positions.size());
  constexpr std::int64_t kBlock = 4096;
  const auto n = std::int64_t(storage.size());
  parallel_for(0, (n + kBlock - 1) / kBlock, [&](std::int64_t block) {
    for (std::int64_t i = block * kBlock; i < std::min(n, (block + 1) * kBlock); ++i) {
      storage[i] = posed_position(*p.mesh, p.poses[knot], std::uint32_t(i));
    }
  });
  return storage.data();
}

bool RayScene::moves(std::uint32_t instance, std::uint32_t shape, TimeSpan span) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(instance, shape);
  if (placed.placement == Placement::kStatic || !(span.length() > 0)) return false;
  const Impl::InstanceMotion& motion = s.motions[instance];
  if (placed.placement == Placement::kInstanced && !motion.moves) return false;
  const auto stretches = s.pieces.stretches(span);
  const std::size_t first = stretches.front().first;
  std::vector<Vec3f> storage[2];
  for (const MotionPieces::Stretch& stretch : stretches) {
    for (std::size_t k = stretch.first; k <= stretch.last; ++k) {
      if (placed.placement == Placement::kInstanced) {
        if (!(motion.knots[k] == motion.knots[first])) return true;
        continue;
      }
      if (placed.poses[k] == placed.poses[first]) continue;
      // A pose may differ in what no vertex follows.
      const Vec3f *a = s.positions_at(placed, first, storage[0]), *b = s.positions_at(placed, k, storage[1]);
      for (const std::uint32_t v : placed.mesh->indices) {
        if (!(a[v] == b[v])) return true;
      }
    }
  }
  return false;
}

Bounds3f RayScene::Impl::swept_mesh(const PlacedShape& p, TimeSpan span) const {
  Bounds3f box;
  std::vector<Vec3f> storage[2];
  for (const MotionPieces::Stretch& stretch : pieces.stretches(span)) {
    // Vertices are linear between knots: they are furthest at knots, or at the ends of the span.
    for (std::size_t k = stretch.first; k <= stretch.last; ++k) {
      const double time = pieces.knots()[k].time;
      const bool within = time >= stretch.span.begin && time <= stretch.span.end;
      const double end = std::clamp(time, stretch.span.begin, stretch.span.end);
      const std::size_t other = time < end ? std::min(k + 1, stretch.last) : std::max(k, stretch.first + 1) - 1;
      const auto blend = float(within || other == k ? 0 : std::min(std::abs(end - time) / pieces.grid().step, 1.0));
      const Vec3f* at = positions_at(p, k, storage[0]);
      const Vec3f* towards = blend > 0 ? positions_at(p, other, storage[1]) : at;
      for (const std::uint32_t v : p.mesh->indices) box.extend(lerp(at[v], towards[v], blend));
    }
  }
  return box;
}

Bounds3f RayScene::Impl::swept_instance(const PlacedShape& p, std::uint32_t instance, TimeSpan span) const {
  const InstanceMotion& motion = motions[instance];
  if (!motion.moves) return bounds_under(p, Affine3d(motion.world));
  if (p.mesh && p.box.empty()) return {};
  const Bounds3f own = p.mesh ? p.box : analytic::unit_bounds(p.analytic.kind);
  Bounds3f box;
  for (const MotionPieces::Stretch& stretch : pieces.stretches(span)) {
    const auto time = [&](std::size_t k) { return pieces.knots()[k].time; };
    if (stretch.first == stretch.last) box.extend(bounds_under(p, Affine3d(compose(motion.knots[stretch.first]))));
    for (std::size_t k = stretch.first; k < stretch.last; ++k) {
      const AffineKnot &a = motion.knots[k], &b = motion.knots[k + 1];
      const double begin = std::clamp((stretch.span.begin - time(k)) / pieces.grid().step, 0.0, 1.0);
      const double end = std::clamp((stretch.span.end - time(k)) / pieces.grid().step, begin, 1.0);
      // The path of a point is x(s) = R(s) U(s) x + T(s) with U and T linear and R turning by `angle` in all, so
      // |x''| <= angle^2 |U x| + 2 angle |U' x|, and it strays from the chord of a part h of it by h^2 / 8 of that at
      // most. Where quaternions are close they are not turned evenly: a twentieth more.
      const double cosine = dot(a.q, b.q) / std::sqrt(double(dot(a.q, a.q)) * dot(b.q, b.q));
      const double angle = 2 * std::acos(std::min(std::abs(cosine), 1.0));
      const Affine3d u0 = Affine3d(upper(a)), u1 = Affine3d(upper(b));
      double reach = 0, change = 0;
      for (int i = 0; i < 8; ++i) {
        const Vec3f c = p.mesh ? corner(own, i) : p.analytic.object_from_unit.point(corner(own, i));
        const Vec3d x0 = u0.vector(Vec3d(c)), x1 = u1.vector(Vec3d(c));
        reach = std::max({reach, length(x0), length(x1)});
        change = std::max(change, length(x1 - x0));
      }
      const int parts = 1 + int(16 / kPiD * angle * (end - begin));
      const double h = (end - begin) / parts;
      const auto stray = float(1.05 * h * h / 8 * (angle * angle * reach + 2 * angle * change));
      Bounds3f part;
      for (int i = 0; i <= parts; ++i) part.extend(bounds_under(p, interpolate_moving(a, b, begin + i * h).map));
      box.extend(Bounds3f{part.lo - Vec3f{stray, stray, stray}, part.hi + Vec3f{stray, stray, stray}});
    }
  }
  return box;
}

Bounds3f RayScene::swept_bounds(std::uint32_t instance, std::uint32_t shape, TimeSpan span) const {
  const Impl& s = *impl_;
  const PlacedShape& placed = s.find(instance, shape);
  // Rays have float times, which reach a little beyond.
  const double rounding = 2e-7 * s.rays.length();
  span = {span.begin - rounding, span.end + rounding};
  if (placed.placement == Placement::kStatic) {
    if (!placed.mesh) return padded(bounds_under(placed, Affine3d{}));
    Bounds3f box;
    for (const std::uint32_t v : placed.mesh->indices) box.extend(placed.knots[0].positions[v]);
    return padded(box);
  }
  return padded(placed.placement == Placement::kDeforming ? s.swept_mesh(placed, span)
                                                          : s.swept_instance(placed, instance, span));
}

}  // namespace tempera
