// SPDX-License-Identifier: Apache-2.0
#include "motion.h"

#include <cmath>

namespace tempera {

AffineKnot decompose(const Affine3d& m) {
  constexpr double kTiny = 1e-12;
  const double largest = std::max({length(m.x), length(m.y), length(m.z), 1e-6});
  const auto unit_or = [&](const Vec3d& v, const Vec3d& fallback) {
    return length(v) > kTiny * largest ? normalize(v) : fallback;
  };
  const Vec3d q0 = unit_or(m.x, {1, 0, 0});
  const Vec3d y = m.y - q0 * dot(q0, m.y);
  const Basis other{Vec3f(q0)};
  const Vec3d q1 = unit_or(y, normalize(Vec3d(other.s) - q0 * dot(q0, Vec3d(other.s))));
  const Vec3d q2 = cross(q0, q1);
  const auto away_from_zero = [&](double s) {
    return std::abs(s) < 1e-6 * largest ? std::copysign(1e-6 * largest, s) : s;
  };
  AffineKnot k;
  k.q = [&] {
    const Quatd q = quaternion(Affine3d{q0, q1, q2});
    return Quatf{float(q.w), float(q.x), float(q.y), float(q.z)};
  }();
  k.scale = Vec3f(Vec3d{away_from_zero(dot(q0, m.x)), away_from_zero(dot(q1, m.y)), away_from_zero(dot(q2, m.z))});
  k.skew = Vec3f(Vec3d{dot(q0, m.y), dot(q0, m.z), dot(q1, m.z)});
  k.translation = Vec3f(m.translation);
  return k;
}

static Affine3f upper(const Vec3f& scale, const Vec3f& skew) {
  return {{scale.x, 0, 0}, {skew.x, scale.y, 0}, {skew.y, skew.z, scale.z}};
}

Affine3f compose(const AffineKnot& k) {
  Affine3f m = rotation(k.q) * upper(k.scale, k.skew);
  m.translation = k.translation;
  return m;
}

Affine3f interpolate(const AffineKnot& a, const AffineKnot& b, float s) {
  return compose(
      {slerp(a.q, b.q, s), lerp(a.scale, b.scale, s), lerp(a.skew, b.skew, s), lerp(a.translation, b.translation, s)});
}

Affine3f interpolate_derivative(const AffineKnot& a, const AffineKnot& b, float s) {
  const Quatf q = slerp(a.q, b.q, s);
  // slerp turns about one axis at a constant rate: dR/ds = [w]x R with w the rotation vector from a to b.
  Quatf turn = b.q * Quatf{a.q.w, -a.q.x, -a.q.y, -a.q.z};
  if (turn.w < 0) turn = -turn;
  const Vec3f axis{turn.x, turn.y, turn.z};
  const float sine = length(axis);
  const float angle = 2 * std::atan2(sine, turn.w);
  const Vec3f w = sine > 0 ? axis * (angle / sine) : Vec3f{};
  const Affine3f r = rotation(q);
  const Affine3f dr{cross(w, r.x), cross(w, r.y), cross(w, r.z)};
  const Affine3f u = upper(lerp(a.scale, b.scale, s), lerp(a.skew, b.skew, s));
  const Affine3f du = upper(b.scale - a.scale, b.skew - a.skew);
  const Affine3f m1 = dr * u, m2 = r * du;
  return {m1.x + m2.x, m1.y + m2.y, m1.z + m2.z, b.translation - a.translation};
}

}  // namespace tempera
