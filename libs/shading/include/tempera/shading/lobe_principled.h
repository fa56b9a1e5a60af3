// SPDX-License-Identifier: Apache-2.0
#pragma once
// The diffuse and clearcoat lobes of Mitsuba's `principled` (after Burley 2012, 2015); its main specular lobe is a
// RoughInterfaceLobe<PrincipledFresnel>.
#include "tempera/shading/lobe_diffuse.h"

namespace tempera {

/// Diffuse, retro-reflection, flattened (fake subsurface) and sheen, seen from the front.
struct PrincipledDiffuseLobe : CosineSampled {
  Rgb base_color;  ///< times (1 - metallic)(1 - spec_trans)
  Rgb sheen;       ///< tinted, times (1 - metallic)
  float surface_roughness = 0.5f;
  float flatness = 0;
  LobeEval eval(const Vec3f& wo, const Vec3f& wi) const;
};

/// Isotropic GTR1 with Mitsuba's fixed masking of alpha 0.25, seen from the front.
struct ClearcoatLobe {
  static constexpr bool kDelta = false;
  float weight = 0;  ///< clearcoat / 4
  float alpha = 0.1f;
  float eta = 1.5f;  ///< only decides which cosine Schlick's term uses
  float roughness() const { return alpha; }
  LobeEval eval(const Vec3f& wo, const Vec3f& wi) const;
  bool sample(const Vec3f& wo, float, const Vec2f& u, Vec3f& wi) const;
};

}  // namespace tempera
