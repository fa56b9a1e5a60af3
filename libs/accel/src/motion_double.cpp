// SPDX-License-Identifier: Apache-2.0
#include "motion.h"

namespace tempera {

template <class T>
Affine3<T> upper(const Vec3<T>& scale, const Vec3<T>& skew) {
  return {{scale.x, 0, 0}, {skew.x, scale.y, 0}, {skew.y, skew.z, scale.z}};
}

Affine3f upper(const AffineKnot& k) { return upper(k.scale, k.skew); }

MovingAffine interpolate_moving(const AffineKnot& a, const AffineKnot& b, double s) {
  const auto in_double = [](const Quatf& q) { return normalize(Quatd{q.w, q.x, q.y, q.z}); };
  const Quatd from = in_double(a.q);
  Quatd to = in_double(b.q);
  if (dot(from, to) < 0) to = -to;
  Quatd q, dq;  // slerp of core/vec.h and its derivative
  if (const double c = dot(from, to); c > 0.9995) {
    const Quatd sum = from * (1 - s) + to * s, change = to - from;
    const double scale = 1 / std::sqrt(dot(sum, sum));
    q = sum * scale;
    dq = (change - q * dot(q, change)) * scale;
  } else {
    const double angle = std::acos(c), inv = 1 / std::sin(angle);
    q = (from * std::sin((1 - s) * angle) + to * std::sin(s * angle)) * inv;
    dq = (to * std::cos(s * angle) - from * std::cos((1 - s) * angle)) * (angle * inv);
  }
  const Quatd turn = dq * Quatd{q.w, -q.x, -q.y, -q.z};  // half the angular velocity w: dR/ds = [w]x R
  const Vec3d w = Vec3d{turn.x, turn.y, turn.z} * 2.0;
  const Affine3d r = rotation(q), dr{cross(w, r.x), cross(w, r.y), cross(w, r.z)};
  const Vec3d scale(a.scale), skew(a.skew), translation(a.translation);
  const Vec3d dscale = Vec3d(b.scale) - scale, dskew = Vec3d(b.skew) - skew;
  const Vec3d dtranslation = Vec3d(b.translation) - translation;
  const Affine3d u = upper(scale + dscale * s, skew + dskew * s), du = upper(dscale, dskew);
  const Affine3d turned = dr * u, stretched = r * du;
  MovingAffine m{r * u, {turned.x + stretched.x, turned.y + stretched.y, turned.z + stretched.z, dtranslation}};
  m.map.translation = translation + dtranslation * s;
  return m;
}

}  // namespace tempera
