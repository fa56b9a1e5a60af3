// SPDX-License-Identifier: Apache-2.0
#include "tempera/shading/microfacet.h"

namespace tempera {
namespace {

/// Inverse error function for |x| < 1, relative error below 4e-7 [Giles 2012, single precision].
float erf_inverse(float x) {
  float w = -std::log((1 - x) * (1 + x));
  float p;
  if (w < 5) {
    w -= 2.5f;
    p = 2.81022636e-08f;
    for (const float c : {3.43273939e-07f, -3.5233877e-06f, -4.39150654e-06f, 0.00021858087f, -0.00125372503f,
                          -0.00417768164f, 0.246640727f, 1.50140941f})
      p = c + p * w;
  } else {
    w = std::sqrt(w) - 3;
    p = -0.000200214257f;
    for (const float c : {0.000100950558f, 0.00134934322f, -0.00367342844f, 0.00573950773f, -0.0076224613f,
                          0.00943887047f, 1.00167406f, 2.83297682f})
      p = c + p * w;
  }
  return p * x;
}

/// Slopes of a visible Beckmann facet with alpha 1, seen from a direction in the xz plane. The distribution along x is
/// inverted by Newton's method in the variable erf(slope), where it is smooth: no jumps in u, so that stratification
/// and small steps of Markov chains survive [Jakob 2014, "An improved visible normal sampling routine"].
Vec2f beckmann_visible_slopes(float cos_o, Vec2f u) {
  constexpr float kInvSqrtPi = 0.56418958354775629f;
  const float tan_o = std::sqrt(std::max(1 - cos_o * cos_o, 0.0f)) / cos_o;
  const float cot_o = tan_o > 0 ? 1 / tan_o : kInfinity;
  const float top = std::erf(cot_o);  // slopes beyond cot_o face away
  const float edge = kInvSqrtPi * tan_o * (tan_o > 0 ? std::exp(-cot_o * cot_o) : 0.0f);
  u = {std::clamp(u.x, 1e-6f, 1 - 1e-6f), std::clamp(u.y, 1e-6f, 1 - 1e-6f)};
  // First guess: the closed form at grazing incidence, the least linear case.
  float x = top - (top + 1) * std::erf(std::sqrt(-std::log(u.x)));
  const float target = u.x * (1 + top + edge);
  for (int i = 0; i < 3; ++i) {
    const float slope = erf_inverse(x);
    const float value = 1 + x + kInvSqrtPi * tan_o * std::exp(-slope * slope) - target;
    const float step = value / (1 - slope * tan_o);
    x = std::clamp(x - step, -1 + 1e-7f, 1 - 1e-7f);
    if (std::abs(step) < 1e-6f) break;
  }
  return {erf_inverse(x), erf_inverse(2 * u.y - 1)};
}

/// A normal of the whole distribution with density d(m) m.z.
Vec3f sample_all(const Microfacet& f, const Vec2f& u) {
  const float phi = 2 * kPi * u.y;
  float c = std::cos(phi), s = std::sin(phi);
  if (f.alpha_u != f.alpha_v) {  // warp the angle so that its density matches the ellipse
    const Vec2f e{f.alpha_u * c, f.alpha_v * s};
    const float l = length(e);
    c = e.x / l, s = e.y / l;
  }
  const float alpha2 = 1 / (sqr(c / f.alpha_u) + sqr(s / f.alpha_v));
  const float tan2 = f.type == Microfacets::kBeckmann ? -alpha2 * std::log(1 - u.x) : alpha2 * u.x / (1 - u.x);
  const float cos_m = 1 / std::sqrt(1 + tan2), sin_m = std::sqrt(std::max(1 - cos_m * cos_m, 0.0f));
  return {c * sin_m, s * sin_m, cos_m};
}

}  // namespace

Vec3f Microfacet::sample(const Vec3f& wo, const Vec2f& u) const {
  if (!sample_visible) return sample_all(*this, u);
  // Stretch so that both alphas become 1, sample there, and unstretch the normal [Heitz 2014; 2018].
  const Vec3f v = normalize(Vec3f{alpha_u * wo.x, alpha_v * wo.y, wo.z});
  Vec3f m;
  if (type == Microfacets::kGgx) {
    const float l2 = v.x * v.x + v.y * v.y;
    const Vec3f t1 = l2 > 0 ? Vec3f{-v.y, v.x, 0} * (1 / std::sqrt(l2)) : Vec3f{1, 0, 0};
    const Vec3f t2 = cross(v, t1);
    Vec2f p = square_to_disk(u);  // on the disk that faces v; its lower part is foreshortened by the hemisphere's edge
    const float s = 0.5f * (1 + v.z);
    p.y = (1 - s) * std::sqrt(std::max(1 - p.x * p.x, 0.0f)) + s * p.y;
    m = t1 * p.x + t2 * p.y + v * std::sqrt(std::max(1 - p.x * p.x - p.y * p.y, 0.0f));
  } else {
    const float l = std::sqrt(v.x * v.x + v.y * v.y);
    const float c = l > 0 ? v.x / l : 1, s = l > 0 ? v.y / l : 0;
    const Vec2f slope = beckmann_visible_slopes(std::min(v.z, 1.0f), u);
    m = {-(c * slope.x - s * slope.y), -(s * slope.x + c * slope.y), 1};
  }
  return normalize(Vec3f{alpha_u * m.x, alpha_v * m.y, std::max(m.z, 1e-6f)});
}

}  // namespace tempera
