// SPDX-License-Identifier: Apache-2.0
#pragma once
// Shading normals that do not fit the surface that carries them: interpolated over coarse meshes and mapped, they may
// face away from the viewer or mirror the view into the surface, and light ends for them where it does not end for the
// surface. What is seen along an eye path bends them back and lets the light fade out instead. This costs reciprocity:
// both depend on which of the two directions is the viewer's. Light paths use the normals as they are.
#include <algorithm>
#include <cmath>

#include "tempera/core/vec.h"

namespace tempera {

/// `frame` about another unit normal: the tangent's direction and the handedness stay.
inline Basis with_normal(const Basis& frame, const Vec3f& n) {
  Basis r = Basis::with_tangent(n, frame.s);
  if (dot(cross(frame.s, frame.t), frame.n) < 0) r.t = -r.t;
  return r;
}

/// The normal nearest to `n`, in the plane of `n` and the geometric normal `ng` (both unit and meant for the same side
/// of the surface), that faces `wo` and whose mirror direction of `wo` stays above the surface on the side of `wo`. `n`
/// itself where it does. Continuous in all arguments.
///
/// The condition is that of Iray and Cycles [Keller 2017]; the closed form is ours. With ng and the
/// direction of n along the surface as axes, wo is (x, z), and so is its mirror direction (x', z') of the same length:
/// the normal halfway between them mirrors one into the other. The one nearest to n has z' as low as allowed.
inline Vec3f bend_normal(const Vec3f& n, const Vec3f& ng, const Vec3f& wo) {
  constexpr float kLowest = 0.01f;  // height of the mirror direction, or half of the viewer's if that is lower
  const float wo_ng = dot(wo, ng), wo_n = dot(wo, n), n_ng = dot(n, ng);
  const float side = wo_ng < 0 ? -1.0f : 1.0f, z = side * wo_ng;
  const float lowest = std::min(kLowest, 0.5f * z);
  if ((side * wo_n > 0 && side * 2 * wo_n * n_ng - z >= lowest) || !(z > 0)) return n;
  const Vec3f along = (n - ng * n_ng) * side;
  const float l = length(along);
  if (!(l > 1e-6f)) return ng;
  const float x = dot(wo, along) / l, mirrored = std::sqrt(x * x + z * z - lowest * lowest);
  const float sum = x > 0 ? mirrored + x : (z * z - lowest * lowest) / (mirrored - x);  // without cancellation
  return normalize(along * (sum * side / l) + ng * (z + lowest));
}

/// What a reflecting lobe about the normal n keeps of light from wi: fades out where the surface turns away from the
/// light, instead of at the first facet that does [Chiang 2019]. For a lobe of roughness alpha below 1 (its width)
/// the fading is as much narrower, down to a step for a mirror: otherwise bent mirrors would be dark at silhouettes.
/// `above`: cosine of wi to ng, on the side of the viewer; `cos_n` that of wi to n; `n_ng` that of n to ng.
inline float terminator_factor(float above, float cos_n, float n_ng, float roughness) {
  if (!(above > 0)) return 0;
  const float g = above / std::abs(cos_n * n_ng * std::max(roughness, 1e-3f));
  return g < 1 ? g * (1 + g - g * g) : 1.0f;
}

}  // namespace tempera
