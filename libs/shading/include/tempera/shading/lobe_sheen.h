// SPDX-License-Identifier: Apache-2.0
#pragma once
// Sheen of KHR_materials_sheen: "Charlie" distribution and masking [Estevez 2017], seen from the front.
#include "tempera/shading/lobe_diffuse.h"

namespace tempera {

struct SheenLobe {
  static constexpr bool kDelta = false;
  Rgb color;
  float alpha = 1;  ///< sheen roughness squared
  float roughness() const { return 1; }
  LobeEval eval(const Vec3f& wo, const Vec3f& wi) const;
  /// Uniform over the hemisphere: the lobe is strongest at grazing angles.
  bool sample(const Vec3f& wo, float, const Vec2f& u, Vec3f& wi) const;
};

/// Directional albedo of a white sheen lobe, tabulated. cosine in [0,1], alpha in [0,1].
float sheen_albedo(float cosine, float alpha);

}  // namespace tempera
