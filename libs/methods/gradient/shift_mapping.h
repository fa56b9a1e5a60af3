// SPDX-License-Identifier: Apache-2.0
#pragma once
// The local steps of the shift mapping from a path of one pixel to a path of another, with the change of solid angle
// at the vertex (Jacobian) that each makes. [Kettunen 2015, Sec. 5; Manzi 2016, Sec. 3]
#include <optional>

#include "tempera/core/vec.h"

namespace tempera {

/// Reconnection to the same point y with unit geometric normal n: from x' instead of from x.
/// |d omega' / d omega| = (cos' r^2) / (cos r'^2).
inline float reconnection_jacobian(const Vec3f& x, const Vec3f& x_offset, const Vec3f& y, const Vec3f& n) {
  const Vec3f d = y - x, d_offset = y - x_offset;
  const float r2 = length_squared(d), r2_offset = length_squared(d_offset);
  const float cosine = std::abs(dot(n, d)), cosine_offset = std::abs(dot(n, d_offset));  // times r, times r'
  const float j = cosine_offset * r2 * std::sqrt(r2) / (cosine * r2_offset * std::sqrt(r2_offset));
  return std::isfinite(j) ? j : 0.0f;
}

struct ShiftedDirection {
  Vec3f wi;            ///< local, unit
  float jacobian = 0;  ///< |d wi' / d wi|
};

/// Reflection that keeps the half vector of (wo, wi): all directions local to the shading frames, away from the
/// surface.
inline std::optional<ShiftedDirection> shift_reflection(const Vec3f& wo, const Vec3f& wi, const Vec3f& wo_offset) {
  Vec3f h = wo + wi;
  const float l = length(h);
  if (!(l > 0)) return std::nullopt;
  h = h * (1 / l);
  const Vec3f wi_offset = h * (2 * dot(wo_offset, h)) - wo_offset;
  const float cosine = std::abs(dot(wi, h)), cosine_offset = std::abs(dot(wi_offset, h));
  if (!(cosine > 0) || !(wi_offset.z * wo_offset.z > 0)) return std::nullopt;
  return ShiftedDirection{wi_offset, cosine_offset / cosine};
}

/// Refraction that keeps the half vector; eta: index on the side of wi over that on the side of wo, at either point.
/// Unlike public implementations this has the factor eta^2 / eta'^2 where the two differ.
inline std::optional<ShiftedDirection> shift_refraction(const Vec3f& wo, const Vec3f& wi, float eta,
                                                        const Vec3f& wo_offset, float eta_offset) {
  const Vec3f sum = wo + wi * eta;
  const float l = length(sum);
  if (!(l > 0)) return std::nullopt;
  Vec3f h = sum * (1 / l);
  if (dot(h, wo) < 0) h = -h;  // the facet's normal on the side of wo
  if (!(dot(h, wi) < 0) || !(dot(h, wo_offset) > 0)) return std::nullopt;
  const float c = dot(h, wo_offset), sin2 = (1 - c * c) / sqr(eta_offset);
  if (!(sin2 < 1)) return std::nullopt;  // total reflection
  const Vec3f wi_offset = normalize(h * (c / eta_offset - std::sqrt(1 - sin2)) - wo_offset * (1 / eta_offset));
  if (!(wi_offset.z * wo_offset.z < 0)) return std::nullopt;
  const float before = sqr(eta) * std::abs(dot(wi, h)) / length_squared(sum);
  const float after =
      sqr(eta_offset) * std::abs(dot(wi_offset, h)) / length_squared(wo_offset + wi_offset * eta_offset);
  if (!(after > 0)) return std::nullopt;
  return ShiftedDirection{wi_offset, before / after};
}

/// Passage through a thin rough sheet: reflection, mirrored to the other side.
inline std::optional<ShiftedDirection> shift_passage(const Vec3f& wo, const Vec3f& wi, const Vec3f& wo_offset) {
  auto r = shift_reflection(wo, {wi.x, wi.y, -wi.z}, wo_offset);
  if (r) r->wi.z = -r->wi.z;
  return r;
}

}  // namespace tempera
