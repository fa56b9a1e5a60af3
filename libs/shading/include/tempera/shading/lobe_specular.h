// SPDX-License-Identifier: Apache-2.0
#pragma once
// Delta lobes: mirror reflection, refraction, and straight passage through a thin sheet. `transmits` tells those that
// belong to an interface that lets light through.
#include <cmath>

#include "tempera/shading/fresnel.h"

namespace tempera {

/// The one direction of a delta lobe.
struct DeltaSample {
  Vec3f wi;
  Rgb f;          ///< coefficient of the delta; for refraction scaled to radiance (1 / eta^2)
  float eta = 1;  ///< index on the side of wi over that of wo
  bool valid = false;
};

template <class Fresnel>
struct MirrorLobe {
  static constexpr bool kDelta = true;
  Fresnel fresnel;
  bool both_sides = false;  ///< of an interface that transmits
  float roughness() const { return 0; }
  bool transmits() const { return both_sides; }
  DeltaSample sample(const Vec3f& wo) const {
    if (wo.z == 0 || (wo.z < 0 && !both_sides)) return {};
    return {{-wo.x, -wo.y, wo.z}, fresnel.reflect(wo.z), 1, true};
  }
};

/// Refraction at an interface (Fresnel has `eta`), from both sides.
template <class Fresnel>
struct RefractionLobe {
  static constexpr bool kDelta = true;
  Fresnel fresnel;
  float roughness() const { return 0; }
  bool transmits() const { return true; }
  DeltaSample sample(const Vec3f& wo) const {
    const DielectricInterface face = dielectric_interface(wo.z, fresnel.eta);
    if (wo.z == 0 || face.cos_t == 0) return {};
    const float s = 1 / face.eta;
    return {{-s * wo.x, -s * wo.y, face.cos_t}, fresnel.transmit(wo.z) * (s * s), face.eta, true};
  }
};

/// Passage through a thin sheet in the direction of the ray, from both sides.
template <class Fresnel>
struct PassageLobe {
  static constexpr bool kDelta = true;
  Fresnel fresnel;
  float roughness() const { return 0; }
  bool transmits() const { return true; }
  DeltaSample sample(const Vec3f& wo) const {
    if (wo.z == 0) return {};
    return {-wo, fresnel.transmit(std::abs(wo.z)), 1, true};
  }
};

}  // namespace tempera
