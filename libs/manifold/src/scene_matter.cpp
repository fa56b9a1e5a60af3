// SPDX-License-Identifier: Apache-2.0
#include "tempera/manifold/scene_matter.h"

#include <algorithm>
#include <cmath>

namespace tempera {

namespace {

constexpr int kMaxPassed = 4096;     // surfaces that one edge passes: ends endless ones
constexpr double kBefore = 1e-3;     // of a distance
constexpr double kPerturbed = 1e-3;  // radians between normals
constexpr float kOpaque = 0.5f;      // as the layer `motion` has it

}  // namespace

Ray SceneMatter::ray_of(const RayScene& rays, const Vec3d& o, const Vec3d& d, double t, const ChainVertex* from,
                        double& start) const {
  start = 0;
  if (from) {
    const Vec3f along(d);
    return {rays.offset_origin(Vec3f(o), Vec3f(from->specular.surface.ng), along), along, 0, kInfinity, t};
  }
  const Range range = first_range_(o, d, t);
  start = range.tmin;
  return {Vec3f(o + d * start), Vec3f(d), 0, float(range.tmax - range.tmin), t};
}

std::optional<Hit> SceneMatter::find_hit(const RayScene& rays, const Vec3d& start, Ray ray,
                                         const ChainVertex* from) const {
  const float moved = float(dot(Vec3d(ray.o) - start, Vec3d(ray.d)));
  Hit hit;
  for (int i = 0; i < kMaxPassed && rays.intersect(ray, hit); ++i) {
    const SurfacePoint& p = hit.point;
    const Shape& shape = rays.shape(p);
    // A flat primitive is not met again by what leaves it.
    const bool itself = from && p.instance == from->at.point.instance && p.shape == from->at.point.shape &&
                        p.primitive == from->at.point.primitive && std::holds_alternative<Mesh>(shape.geometry);
    const bool unseen = !from && !rays.scene().instances[p.instance].camera_visible;
    bool passes = itself || unseen;
    if (!passes && rays.has_opacity() && shape.material->has_opacity())
      passes = shape.material->opacity(rays.shading_point(p, ray.time, -ray.d)) < kOpaque;
    if (!passes) return Hit{p, hit.t + moved};
    // Beyond it, by as much as rays start off surfaces.
    const Vec3f there = ray.o + ray.d * hit.t;
    Vec3f ng;
    rays.position(p, ray.time, &ng);
    const Vec3f off = rays.offset_origin(there, ng, ray.d);
    ray.tmin = std::max(hit.t + std::abs(dot(off - there, ray.d)), std::nextafter(hit.t, kInfinity));
  }
  return std::nullopt;
}

std::optional<Hit> SceneMatter::first_hit(const Vec3d& o, const Vec3d& d, double t, const ChainVertex* from) const {
  const RayScene& rays = rays_at_(t);
  double start = 0;
  const Ray ray = ray_of(rays, o, d, t, from, start);
  auto hit = find_hit(rays, o + d * start, ray, from);
  if (hit) hit->t = float(double(hit->t) + start);
  return hit;
}

std::optional<ChainMatter::Crossing> SceneMatter::meet(const Vec3d& o, const Vec3d& d, double t,
                                                       const ChainVertex* from) const {
  const RayScene& rays = rays_at_(t);
  double start = 0;
  const Ray ray = ray_of(rays, o, d, t, from, start);
  const Vec3d near = o + d * start;  // to what is met: parallel rays may come from afar
  auto hit = find_hit(rays, near, ray, from);
  if (!hit) return std::nullopt;
  auto at = rays.refine(*hit, near, d, t, &poses_);
  if (!at) {
    // Rays start off surfaces, beside the line, and may meet a neighbour of what it crosses: again, from just before that.
    const double before = hit->t * (1 - kBefore);
    hit = find_hit(rays, near, {Vec3f(near + d * before), ray.d, 0, kInfinity, t}, from);
    if (hit) at = rays.refine(*hit, near, d, t, &poses_);
    if (!at) return std::nullopt;
  }
  Crossing crossing{hit->point, at->u, at->v};
  crossing.point.u = float(at->u), crossing.point.v = float(at->v);  // the ray starts off the line
  return crossing;
}

SceneMatter::Bend SceneMatter::find_bend(const Bsdf& bsdf, const Vec3d& wo, const Vec3d& n, bool refracts) {
  const auto event = bsdf.specular(refracts ? Event::kTransmission : Event::kReflection, Vec3f(wo), Vec3f(n));
  if (!event) return {};
  if (refracts && event->eta == 1) return {Does::kBends, 1};
  if (length(cross(Vec3d(event->n), n)) > kPerturbed) return {Does::kPerturbed, event->eta};
  return {Does::kBends, event->eta};
}

SceneMatter::Bend SceneMatter::find_bend(const Crossing& at, const SurfaceFrame& f, const Vec3d& wo, bool refracts,
                                         double t) const {
  const RayScene& rays = rays_at_(t);
  const ShadingPoint s = rays.shading_point(at.point, t, Vec3f(wo));
  Bsdf bsdf;
  make_bsdf(*rays.shape(at.point).material, s, bsdf);
  return find_bend(bsdf, wo, f.n, refracts);
}

std::optional<double> SceneMatter::eta(const Crossing& at, const SurfaceFrame& f, const Vec3d& wo, bool refracts,
                                       double t) const {
  const bool front = dot(wo, f.n) > 0;
  const auto is_asked = [&](const Known& k) {
    return k.shape == at.point.shape && k.refracts == refracts && k.front == front;
  };
  const auto found = std::find_if(known_.begin(), known_.end(), is_asked);
  const Bend bend = found != known_.end() ? found->bend : find_bend(at, f, wo, refracts, t);
  if (bend.does != Does::kBends) return std::nullopt;  // here: elsewhere it may
  if (found == known_.end()) known_.push_back({at.point.shape, refracts, front, bend});
  return bend.eta;
}

}  // namespace tempera
