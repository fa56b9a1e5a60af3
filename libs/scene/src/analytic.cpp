// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/analytic.h"

#include <cmath>

namespace tempera::analytic {

namespace {

double turn(double y, double x) {  // angle / 2pi in [0,1)
  const double a = std::atan2(y, x) / (2 * kPiD);
  return a < 0 ? a + 1 : a;
}

/// Both crossings of a line with the sphere or the infinite cylinder; false: there are none.
TEMPERA_INLINE bool crossings(bool sphere, const Vec3d& o, const Vec3d& d, double (&t)[2]) {
  const double a = d.x * d.x + d.y * d.y + (sphere ? d.z * d.z : 0);
  if (!(a > 0)) return false;
  // From where the ray is closest to the axis or center: its origin may be millions of radii away where a shape is
  // flat.
  const double closest = -(o.x * d.x + o.y * d.y + (sphere ? o.z * d.z : 0)) / a;
  const Vec3d c = o + d * closest;
  const double half2 = (1 - (c.x * c.x + c.y * c.y + (sphere ? c.z * c.z : 0))) / a;
  if (!(half2 >= 0)) return false;
  const double half = std::sqrt(half2);
  t[0] = closest - half, t[1] = closest + half;
  return true;
}

}  // namespace

std::optional<UnitHit> intersect(AnalyticKind kind, const Vec3d& o, const Vec3d& d, double tmin, double tmax) {
  if (kind == AnalyticKind::kDisk) {
    const double t = -o.z / d.z;
    if (!(t > tmin && t < tmax)) return std::nullopt;
    const Vec3d p = o + d * t;
    const double r2 = p.x * p.x + p.y * p.y;
    if (r2 > 1) return std::nullopt;
    return UnitHit{t, float(std::sqrt(r2)), float(turn(p.y, p.x))};
  }
  const bool sphere = kind == AnalyticKind::kSphere;
  double roots[2];
  if (!crossings(sphere, o, d, roots)) return std::nullopt;
  for (const double t : roots) {
    if (!(t > tmin && t < tmax)) continue;
    const Vec3d p = o + d * t;
    if (sphere) return UnitHit{t, float(turn(p.y, p.x)), float(std::acos(std::clamp(p.z, -1.0, 1.0)) / kPiD)};
    if (p.z >= 0 && p.z <= 1) return UnitHit{t, float(turn(p.y, p.x)), float(p.z)};
  }
  return std::nullopt;
}

std::optional<LineHit> cross_line(AnalyticKind kind, const Vec3d& o, const Vec3d& d, double near) {
  double t = 0;
  if (kind == AnalyticKind::kDisk) {
    t = -o.z / d.z;
  } else {
    double roots[2];
    if (!crossings(kind == AnalyticKind::kSphere, o, d, roots)) return std::nullopt;
    t = std::abs(roots[0] - near) <= std::abs(roots[1] - near) ? roots[0] : roots[1];
  }
  if (!std::isfinite(t)) return std::nullopt;
  const Vec3d p = o + d * t;
  const double r = std::hypot(p.x, p.y), angle = turn(p.y, p.x);
  if (kind == AnalyticKind::kDisk) return LineHit{t, r, angle};
  // Near the poles the arc cosine of z would lose half of the digits.
  return LineHit{t, angle, kind == AnalyticKind::kSphere ? std::atan2(r, p.z) / kPiD : p.z};
}

namespace {

/// Computed in double for either result.
template <class T>
TEMPERA_INLINE UnitPoint<T> evaluate_as(AnalyticKind kind, double u, double v) {
  using V = Vec3<T>;
  UnitPoint<T> r;
  constexpr double two_pi = 2 * kPiD;
  if (kind == AnalyticKind::kSphere) {
    const double phi = two_pi * u, theta = kPiD * v;
    const double cp = std::cos(phi), sp = std::sin(phi), ct = std::cos(theta), st = std::sin(theta);
    r.n = r.p = V(Vec3d{st * cp, st * sp, ct});
    r.dndu = r.dpdu = V(Vec3d{-st * sp, st * cp, 0} * two_pi);
    r.dndv = r.dpdv = V(Vec3d{ct * cp, ct * sp, -st} * kPiD);
  } else if (kind == AnalyticKind::kDisk) {
    const double phi = two_pi * v, cp = std::cos(phi), sp = std::sin(phi);
    r.p = V(Vec3d{u * cp, u * sp, 0});
    r.n = {0, 0, 1};
    r.dpdu = V(Vec3d{cp, sp, 0});
    r.dpdv = V(Vec3d{-sp, cp, 0} * (two_pi * u));
  } else {
    const double phi = two_pi * u, cp = std::cos(phi), sp = std::sin(phi);
    r.p = V(Vec3d{cp, sp, v});
    r.n = V(Vec3d{cp, sp, 0});
    r.dndu = r.dpdu = V(Vec3d{-sp, cp, 0} * two_pi);
    r.dpdv = {0, 0, 1};
  }
  return r;
}

}  // namespace

UnitPoint<double> evaluate(AnalyticKind kind, double u, double v) { return evaluate_as<double>(kind, u, v); }
UnitPoint<float> evaluate(AnalyticKind kind, float u, float v) { return evaluate_as<float>(kind, u, v); }

Bounds3f unit_bounds(AnalyticKind kind) {
  Bounds3f b;
  b.extend(Vec3f{-1, -1, kind == AnalyticKind::kSphere ? -1.0f : 0.0f});
  b.extend(Vec3f{1, 1, kind == AnalyticKind::kDisk ? 0.0f : 1.0f});
  return b;
}

Bounds3f bounds(AnalyticKind kind, const Affine3d& map) {
  // The support function of a ball, or of a disk, in each direction.
  Vec3d reach;
  for (int i = 0; i < 3; ++i) {
    reach[i] = std::sqrt(sqr(map.x[i]) + sqr(map.y[i]) + (kind == AnalyticKind::kSphere ? sqr(map.z[i]) : 0));
  }
  Bounds3f b;
  for (const Vec3d& center : {map.translation, map.translation + map.z}) {
    b.extend(Vec3f(center - reach));
    b.extend(Vec3f(center + reach));
    if (kind != AnalyticKind::kCylinder) break;
  }
  return b;
}

}  // namespace tempera::analytic
