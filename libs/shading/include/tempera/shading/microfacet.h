// SPDX-License-Identifier: Apache-2.0
#pragma once
// Distributions of microfacet normals with Smith masking, and how to sample them. Directions are unit vectors in the
// local shading frame (normal +z, tangent +x); a microfacet normal m has m.z > 0.
#include <cmath>
#include <cstdint>

#include "tempera/core/vec.h"

namespace tempera {

enum class Microfacets : std::uint8_t { kGgx, kBeckmann };

/// Point of the unit disk for u in [0,1)^2: concentric map, area preserving and continuous [Shirley 1997].
inline Vec2f square_to_disk(const Vec2f& u) {
  const float a = 2 * u.x - 1, b = 2 * u.y - 1;
  const bool first = std::abs(a) > std::abs(b);
  const float r = first ? a : b, other = first ? b : a;
  // The angle to the nearest axis is at most pi/4 either way, where short polynomials (the minimax coefficients of
  // Cephes' sinf and cosf) are as exact as the library's functions.
  const float phi = r != 0 ? (kPi / 4) * (other / r) : 0, x = phi * phi;
  const float sine = phi + phi * x * (-1.6666654611e-1f + x * (8.3321608736e-3f + x * -1.9515295891e-4f));
  const float cosine =
      1 - 0.5f * x + x * x * (4.166664568298827e-2f + x * (-1.388731625493765e-3f + x * 2.443315711809948e-5f));
  return first ? Vec2f{r * cosine, r * sine} : Vec2f{r * sine, r * cosine};
}
/// Cosine-distributed direction of the upper hemisphere; density cos / pi.
inline Vec3f square_to_cosine_hemisphere(const Vec2f& u) {
  const Vec2f d = square_to_disk(u);
  return {d.x, d.y, std::sqrt(std::max(1 - d.x * d.x - d.y * d.y, 0.0f))};
}

/// Mirror of `w` about the unit vector `m`.
inline Vec3f mirror(const Vec3f& w, const Vec3f& m) { return m * (2 * dot(w, m)) - w; }

/// Anisotropic GGX (Trowbridge-Reitz) or Beckmann distribution with separable Smith masking, as in Mitsuba.
struct Microfacet {
  Microfacets type = Microfacets::kGgx;
  bool sample_visible = true;  ///< sample only normals that are visible from wo
  float alpha_u = 1, alpha_v = 1;

  Microfacet() = default;
  Microfacet(Microfacets type_, float au, float av, bool visible = true)
      : type(type_), sample_visible(visible), alpha_u(std::max(au, 1e-4f)), alpha_v(std::max(av, 1e-4f)) {}

  float roughness() const { return std::max(alpha_u, alpha_v); }
  /// The same with both alphas scaled.
  Microfacet scaled(float s) const { return {type, alpha_u * s, alpha_v * s, sample_visible}; }

  /// Density of normals per projected area.
  float d(const Vec3f& m) const {
    const float c2 = m.z * m.z;
    const float e = sqr(m.x / alpha_u) + sqr(m.y / alpha_v);
    const float r = type == Microfacets::kBeckmann ? std::exp(-e / c2) / (kPi * alpha_u * alpha_v * c2 * c2)
                                                   : 1 / (kPi * alpha_u * alpha_v * sqr(e + c2));
    return r * m.z > 1e-20f ? r : 0;  // below this nothing is left of float precision
  }
  /// Fraction of microfacets with normal m that is visible from v; 0 if macro and micro surface disagree on the side.
  float g1(const Vec3f& v, const Vec3f& m) const {
    if (!(dot(v, m) * v.z > 0)) return 0;
    const float xy = sqr(alpha_u * v.x) + sqr(alpha_v * v.y);
    if (xy == 0) return 1;
    const float tan2 = xy / (v.z * v.z);
    if (type == Microfacets::kGgx) return 2 / (1 + std::sqrt(1 + tan2));
    const float a = 1 / std::sqrt(tan2);  // rational fit to 0.35 % [Walter 2007, Sec. 5.2]
    return a >= 1.6f ? 1 : (3.535f * a + 2.181f * a * a) / (1 + 2.276f * a + 2.577f * a * a);
  }
  /// Solid angle density of `sample` for wo.z > 0.
  float pdf(const Vec3f& wo, const Vec3f& m) const {
    return d(m) * (sample_visible ? g1(wo, m) * std::abs(dot(wo, m)) / wo.z : m.z);
  }
  /// Draws a normal for wo.z > 0 and u in [0,1)^2.
  Vec3f sample(const Vec3f& wo, const Vec2f& u) const;
};

}  // namespace tempera
