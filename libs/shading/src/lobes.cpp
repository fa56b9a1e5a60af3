// SPDX-License-Identifier: Apache-2.0
// The lobes that are too long or too rare for their headers.
#include "tempera/shading/lobes.h"

namespace tempera {

LobeEval PrincipledDiffuseLobe::eval(const Vec3f& wo, const Vec3f& wi) const {
  const float p = density(wo, wi);
  if (p <= 0) return {};
  const float fo = schlick_weight(wo.z), fi = schlick_weight(wi.z);
  const float cos_d = dot(normalize(wo + wi), wi);
  const float diffuse = (1 - 0.5f * fi) * (1 - 0.5f * fo);
  const float rr = 2 * surface_roughness * cos_d * cos_d;
  float f = diffuse + rr * (fo + fi + fo * fi * (rr - 1));
  if (flatness > 0) {  // [Burley 2015]: diffusion profile flattened after Hanrahan and Krueger
    const float fss90 = 0.5f * rr;
    const float fss = (1 + (fss90 - 1) * fo) * (1 + (fss90 - 1) * fi);
    const float ss = 1.25f * (fss * (1 / (wo.z + wi.z) - 0.5f) + 0.5f);
    f += flatness * (ss - f);
  }
  return {base_color * (f * p) + sheen * (schlick_weight(std::abs(cos_d)) * wi.z), p};
}

namespace {
float gtr1(const Vec3f& m, float alpha) {
  const float a2 = alpha * alpha;  // the sum of squares is 1 + (a2 - 1) m.z^2 without its cancellation at m.z = 1
  return (a2 - 1) / (kPi * std::log(a2) * (m.x * m.x + m.y * m.y + a2 * m.z * m.z));
}
float coat_masking(float c) { return 2 / (1 + std::sqrt(1 + 0.0625f * (1 - c * c) / (c * c))); }  // alpha 0.25
}  // namespace

LobeEval ClearcoatLobe::eval(const Vec3f& wo, const Vec3f& wi) const {
  if (!(wo.z > 0 && wi.z > 0)) return {};
  const Vec3f m = normalize(wo + wi);
  const float cos_m = dot(wo, m);
  if (!(cos_m > 0)) return {};
  const float s = schlick_weight_interface(cos_m, eta);
  const float d = gtr1(m, alpha);
  const float f = weight * (0.04f + 0.96f * s) * d * coat_masking(wo.z) * coat_masking(wi.z) * wi.z;
  return {Rgb(f), d * m.z / (4 * cos_m)};
}

bool ClearcoatLobe::sample(const Vec3f& wo, float, const Vec2f& u, Vec3f& wi) const {
  if (!(wo.z > 0)) return false;
  const float a2 = alpha * alpha;
  const float c2 = std::clamp((1 - std::pow(a2, 1 - u.y)) / (1 - a2), 0.0f, 1.0f);
  const float phi = 2 * kPi * u.x, s = std::sqrt(1 - c2);
  wi = mirror(wo, {s * std::cos(phi), s * std::sin(phi), std::sqrt(c2)});
  return wi.z > 0;
}

namespace {
/// Masking of the sheen distribution: numerical fit of [Estevez 2017, Sec. 3].
float sheen_lambda(float c, float alpha) {
  const float t = sqr(1 - alpha);
  const auto mix = [t](float a, float b) { return a + t * (b - a); };
  const float a = mix(21.5473f, 25.3245f), b = mix(3.82987f, 3.32435f), p = mix(0.19823f, 0.16801f);
  const float d = mix(-1.97760f, -1.27393f), e = mix(-4.32054f, -4.85967f);
  const auto l = [&](float x) { return a / (1 + b * std::pow(x, p)) + d * x + e; };
  return c < 0.5f ? std::exp(l(c)) : std::exp(2 * l(0.5f) - l(1 - c));
}
}  // namespace

LobeEval SheenLobe::eval(const Vec3f& wo, const Vec3f& wi) const {
  if (!(wo.z > 0 && wi.z > 0)) return {};
  const Vec3f m = normalize(wo + wi);
  const float inv = 1 / alpha;
  const float sin2 = std::max(1 - m.z * m.z, 0.0f);
  const float d = (2 + inv) * std::pow(sin2, 0.5f * inv) / (2 * kPi);
  const float g = 1 / (1 + sheen_lambda(wo.z, alpha) + sheen_lambda(wi.z, alpha));
  return {color * (d * g / (4 * wo.z)), 0.5f * kInvPi};
}

bool SheenLobe::sample(const Vec3f& wo, float, const Vec2f& u, Vec3f& wi) const {
  const float r = std::sqrt(std::max(1 - u.x * u.x, 0.0f)), phi = 2 * kPi * u.y;
  wi = {r * std::cos(phi), r * std::sin(phi), u.x};
  return wo.z > 0;
}

}  // namespace tempera
