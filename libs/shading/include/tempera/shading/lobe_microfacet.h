// SPDX-License-Identifier: Apache-2.0
#pragma once
// Rough reflection and refraction by microfacets [Walter 2007] with any Fresnel term.
#include "tempera/shading/lobe_diffuse.h"

namespace tempera {

/// Reflection seen from the front.
template <class Fresnel>
struct MicrofacetReflectionLobe {
  static constexpr bool kDelta = false;
  Microfacet microfacet;
  Fresnel fresnel;
  float roughness() const { return microfacet.roughness(); }

  LobeEval eval(const Vec3f& wo, const Vec3f& wi) const {
    if (!(wo.z > 0 && wi.z > 0)) return {};
    const Vec3f m = normalize(wo + wi);
    const float cos_m = dot(wo, m);
    if (!(cos_m > 0)) return {};
    const float d = microfacet.d(m);
    if (d == 0) return {};
    const float g_o = microfacet.g1(wo, m), s = d / (4 * wo.z);
    return {fresnel.reflect(cos_m) * (s * g_o * microfacet.g1(wi, m)),
            microfacet.sample_visible ? s * g_o : d * m.z / (4 * cos_m)};
  }
  bool sample(const Vec3f& wo, float, const Vec2f& u, Vec3f& wi) const {
    if (!(wo.z > 0)) return false;
    wi = mirror(wo, microfacet.sample(wo, u));
    return wi.z > 0;
  }
};

/// Reflection and refraction at a rough interface, from both sides; the Fresnel term at the sampled microfacet chooses.
template <class Fresnel>
struct RoughInterfaceLobe {
  static constexpr bool kDelta = false;
  static constexpr bool kRefracts = true;
  Microfacet microfacet;
  Fresnel fresnel;
  float roughness() const { return microfacet.roughness(); }
  bool transmits() const {
    if constexpr (requires { fresnel.transmission; }) return fresnel.transmission > 0;
    return true;
  }

  LobeEval eval(const Vec3f& wo, const Vec3f& wi) const {
    if (wo.z == 0 || wi.z == 0) return {};
    const bool reflect = wo.z * wi.z > 0;
    const float eta = wo.z > 0 ? fresnel.eta : 1 / fresnel.eta;
    Vec3f m = normalize(wo + wi * (reflect ? 1.0f : eta));
    if (m.z < 0) m = -m;
    const float om = dot(wo, m), im = dot(wi, m);
    if (!(om * wo.z > 0 && im * wi.z > 0)) return {};
    const float d = microfacet.d(m);
    if (d == 0) return {};
    const float g_o = microfacet.g1(wo, m), g = g_o * microfacet.g1(wi, m);
    const float choice = fresnel.reflect_probability(om);
    const float density = microfacet.sample_visible ? d * g_o * std::abs(om / wo.z)
                                                    : sampling_distribution(wo).pdf(wo.z > 0 ? wo : -wo, m);
    if (reflect) return {fresnel.reflect(om) * (d * g / (4 * std::abs(wo.z))), choice * density / (4 * std::abs(im))};
    // Half-vector Jacobian; 1/eta^2 turns transmitted power into radiance and cancels the eta^2 of the Jacobian.
    const float jacobian = std::abs(im) / sqr(om + eta * im);
    return {fresnel.transmit(om) * (d * g * std::abs(om / wo.z) * jacobian),
            (1 - choice) * density * jacobian * eta * eta};
  }
  bool sample(const Vec3f& wo, float u_choice, const Vec2f& u, Vec3f& wi) const {
    if (wo.z == 0) return false;
    const Vec3f up = wo.z > 0 ? wo : -wo;
    const Vec3f m = sampling_distribution(wo).sample(up, u);
    const float om = dot(wo, m);
    if (!(om * wo.z > 0)) return false;  // a facet seen from behind: only sampling of all normals finds those
    if (u_choice < fresnel.reflect_probability(om)) {
      wi = mirror(wo, m);
      return wi.z * wo.z > 0;
    }
    const DielectricInterface face = dielectric_interface(om, fresnel.eta);
    wi = normalize(m * (om / face.eta + face.cos_t) - wo * (1 / face.eta));
    return face.cos_t != 0 && wi.z * wo.z < 0;
  }

 private:
  /// Without sampling of visible normals a wider distribution bounds the weights [Walter 2007, Sec. 5.3].
  Microfacet sampling_distribution(const Vec3f& wo) const {
    return microfacet.sample_visible ? microfacet : microfacet.scaled(1.2f - 0.2f * std::sqrt(std::abs(wo.z)));
  }
};

/// Rough passage through a thin sheet: the reflection lobe mirrored to the other side (KHR_materials_transmission).
template <class Fresnel>
struct RoughPassageLobe {
  static constexpr bool kDelta = false;
  static constexpr bool kPasses = true;
  Microfacet microfacet;
  Fresnel fresnel;
  float roughness() const { return microfacet.roughness(); }
  bool transmits() const { return true; }

  LobeEval eval(const Vec3f& wo, const Vec3f& wi) const {
    if (!(wo.z * wi.z < 0)) return {};
    const Vec3f o{wo.x, wo.y, std::abs(wo.z)}, i{wi.x, wi.y, std::abs(wi.z)};
    const Vec3f m = normalize(o + i);
    const float cos_m = dot(o, m);
    if (!(cos_m > 0)) return {};
    const float g_o = microfacet.g1(o, m), s = microfacet.d(m) / (4 * o.z);
    return {fresnel.transmit(cos_m) * (s * g_o * microfacet.g1(i, m)), s * g_o};
  }
  bool sample(const Vec3f& wo, float, const Vec2f& u, Vec3f& wi) const {
    if (wo.z == 0) return false;
    const Vec3f o{wo.x, wo.y, std::abs(wo.z)};
    wi = mirror(o, microfacet.sample(o, u));
    const bool valid = wi.z > 0;
    if (wo.z > 0) wi.z = -wi.z;
    return valid;
  }
};

}  // namespace tempera
