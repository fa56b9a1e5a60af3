// SPDX-License-Identifier: Apache-2.0
#pragma once
// Diffuse lobes: Lambert's, and the bases of smooth and rough plastic. Local frame; f includes the cosine of wi.
#include <array>
#include <memory>

#include "tempera/core/vec.h"
#include "tempera/shading/fresnel.h"
#include "tempera/shading/microfacet.h"

namespace tempera {

/// f cos and the solid angle density of the lobe's own `sample`.
struct LobeEval {
  Rgb f_cos;
  float pdf = 0;
};

/// What the cosine-sampled reflecting lobes share.
struct CosineSampled {
  static constexpr bool kDelta = false;
  float roughness() const { return 1; }
  static float density(const Vec3f& wo, const Vec3f& wi) { return wo.z > 0 && wi.z > 0 ? wi.z * kInvPi : 0; }
  bool sample(const Vec3f& wo, float, const Vec2f& u, Vec3f& wi) const {
    wi = square_to_cosine_hemisphere(u);
    return wo.z > 0;
  }
};

struct DiffuseLobe : CosineSampled {
  Rgb reflectance;
  LobeEval eval(const Vec3f& wo, const Vec3f& wi) const {
    const float p = density(wo, wi);
    return {reflectance * p, p};
  }
};

/// Light that enters smooth plastic, scatters diffusely inside (any number of times) and leaves.
struct SmoothPlasticLobe : CosineSampled {
  Rgb reflectance;  ///< of the base with internal scattering, times 1 / eta^2
  float eta = 1.5f;
  LobeEval eval(const Vec3f& wo, const Vec3f& wi) const {
    const float p = density(wo, wi);
    if (p <= 0) return {};
    const float t =
        (1 - dielectric_interface(wo.z, eta).reflectance) * (1 - dielectric_interface(wi.z, eta).reflectance);
    return {reflectance * (p * t), p};
  }
};

/// Transmittance of a rough dielectric from outside over the cosine, and the hemispherical reflectance from inside.
struct RoughTransmittance {
  static constexpr int kSize = 64;
  std::array<float, kSize> external;  ///< at cosines i / (kSize - 1)
  float internal_reflectance = 0;
  float mean = 0;  ///< of `external`, weighted by the cosine
  float at(float cosine) const {
    const float x = cosine * (kSize - 1);
    const int i = std::min(int(x), kSize - 2);
    const float s = x - float(i);
    return external[i] * (1 - s) + external[i + 1] * s;
  }
  /// Tables for an isotropic distribution; computed once per set of arguments. Threads: safe.
  static std::shared_ptr<const RoughTransmittance> make(Microfacets type, float alpha, float eta);
};

/// The same for rough plastic. `table` belongs to the material.
struct RoughPlasticLobe : CosineSampled {
  Rgb reflectance;
  const RoughTransmittance* table = nullptr;
  LobeEval eval(const Vec3f& wo, const Vec3f& wi) const {
    const float p = density(wo, wi);
    if (p <= 0) return {};
    return {reflectance * (p * table->at(wo.z) * table->at(wi.z)), p};
  }
};

}  // namespace tempera
