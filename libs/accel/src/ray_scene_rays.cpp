// SPDX-License-Identifier: Apache-2.0
// Ray queries.
#include <embree3/rtcore.h>

#include <tuple>

#include "ray_scene_impl.h"

namespace tempera {

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
      hit.point.shape = std::uint32_t(s.scene->groups[s.scene->instances[e.instance].group][r.hit.geomID]);
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

bool RayScene::visible(const SurfaceEnd& a, const SurfaceEnd& b, double t) const {
  // One ray for both orders: from the end that stands first by its coordinates.
  const auto key = [](const SurfaceEnd& e) { return std::tie(e.p.x, e.p.y, e.p.z); };
  if (key(a) == key(b)) return is_finite(a.p);
  const bool in_order = key(a) < key(b);
  const SurfaceEnd &first = in_order ? a : b, &second = in_order ? b : a;
  const Vec3f d(second.p - first.p);
  const Vec3f from = offset_origin(Vec3f(first.p), first.ng, d);
  const Vec3f way = offset_origin(Vec3f(second.p), second.ng, -d) - from;
  if (!is_finite(from) || !is_finite(way)) return false;
  return way == Vec3f{} || !occluded({from, way, 0, 1, t});
}

}  // namespace tempera
