// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the materials share.
#include <algorithm>
#include <initializer_list>

#include "tempera/shading/material.h"
#include "tempera/shading/material_catalog.h"
#include "tempera/shading/shading_normal.h"

namespace tempera {

/// Index in `bsdf` of the point's shading frame.
inline int frame_of(const ShadingPoint& point, Bsdf& bsdf) {
  if (point.bsdf_frame >= 0) return point.bsdf_frame;
  return point.bends ? bsdf.add_frame(point.frame, point.unbent) : bsdf.add_frame(point.frame);
}
inline float cos_wo(const ShadingPoint& point) { return dot(point.wo, point.frame.n); }

/// The geometric normal on the side of the viewer.
inline Vec3f ng_towards_viewer(const ShadingPoint& point) { return dot(point.ng, point.wo) < 0 ? -point.ng : point.ng; }

/// Roughness at a point; Beckmann and GGX.
inline Microfacet microfacet_of(const Roughness& r, const ShadingPoint& point) {
  return {r.distribution, r.alpha_u.scalar(point), r.alpha_v.scalar(point), r.sample_visible};
}

/// Whether the lobes depend on the tangent: unless both alphas are known to be equal.
inline bool is_anisotropic(const Roughness& r) {
  if (!r.rough) return false;
  return r.alpha_u.texture != r.alpha_v.texture || !r.alpha_u.factor.is_constant() || !r.alpha_v.factor.is_constant() ||
         r.alpha_u.factor.values()[0].r != r.alpha_v.factor.values()[0].r;
}
inline bool any_texture(std::initializer_list<const Slot*> slots) {
  return std::any_of(slots.begin(), slots.end(), [](const Slot* s) { return s->texture != nullptr; });
}
inline bool any_texture(const Roughness& r) { return r.rough && any_texture({&r.alpha_u, &r.alpha_v}); }

/// Brightness that decides between specular and diffuse sampling, as Mitsuba averages it: constants over the channels,
/// textures by luminance.
inline float sampling_mean(const Slot& slot) { return slot.texture ? luminance(slot.mean()) : mean(slot.mean()); }

// Parameters that several types have.
inline ParamSpec roughness_param(const char* fallback = "0") {
  return {"roughness", fallback, "microfacet roughness alpha in [0,1], or an image; 0: smooth"};
}
inline ParamSpec distribution_param() {
  return {"distribution", "ggx", "microfacet distribution", -1e300, 1e300, {"ggx", "beckmann"}};
}
inline ParamSpec ior_param(double fallback) { return {"int_ior", fallback, "index of refraction inside", 1, 5}; }
inline ParamSpec outer_ior_param() { return {"ext_ior", 1.000277, "index of refraction outside", 1, 5}; }

inline Roughness roughness_from(const MaterialValues& v) {
  Roughness r;
  r.alpha_u = r.alpha_v = v.scalar_slot("roughness");
  r.rough = !r.alpha_u.is_constant() || r.alpha_u.mean().r > 0;
  r.distribution = v.params().get_string("distribution") == "ggx" ? Microfacets::kGgx : Microfacets::kBeckmann;
  return r;
}

/// Throws Error{kOutOfRange} unless both indices are positive and finite.
void check_ior(const char* material, float int_ior, float ext_ior);

}  // namespace tempera
