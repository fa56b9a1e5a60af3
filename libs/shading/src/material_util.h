// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the materials share.
#include "tempera/shading/material.h"

namespace tempera {

/// Index in `bsdf` of the point's shading frame.
inline int frame_of(const ShadingPoint& point, Bsdf& bsdf) {
  return point.bsdf_frame >= 0 ? point.bsdf_frame : bsdf.add_frame(point.frame);
}
inline float cos_wo(const ShadingPoint& point) { return dot(point.wo, point.frame.n); }

/// Roughness at a point; Beckmann and GGX.
inline Microfacet microfacet_of(const Roughness& r, const ShadingPoint& point) {
  return {r.distribution, r.alpha_u.scalar(point), r.alpha_v.scalar(point), r.sample_visible};
}

/// Brightness that decides between specular and diffuse sampling, as Mitsuba averages it: constants over the channels,
/// textures by luminance.
inline float sampling_mean(const Slot& slot) { return slot.texture ? luminance(slot.mean()) : mean(slot.mean()); }

/// Throws Error{kOutOfRange} unless both indices are positive and finite.
void check_ior(const char* material, float int_ior, float ext_ior);

}  // namespace tempera
