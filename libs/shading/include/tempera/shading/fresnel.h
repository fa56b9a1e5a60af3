// SPDX-License-Identifier: Apache-2.0
#pragma once
// Fresnel reflectance: exact for dielectrics and conductors, Schlick's approximation for glTF, and the mixtures that
// Mitsuba's `principled` uses. The structs are what lobes carry: `reflect` and `transmit` are colored coefficients at a
// microfacet (or the surface), `reflect_probability` is the chance that a sample reflects there. Cosines are between
// the normal and the direction that is known; positive means from outside (the front).
#include <cmath>

#include "tempera/core/vec.h"

namespace tempera {

inline float safe_sqrt(float x) { return std::sqrt(std::max(x, 0.0f)); }

/// What happens at an interface whose inside has `eta` times the index of refraction of its outside.
struct DielectricInterface {
  float reflectance;  ///< unpolarised, in [0,1]
  float cos_t;  ///< cosine of the transmitted direction: opposite sign of the incident one, 0 under total reflection
  float eta;    ///< index of the far side over the near side
};
inline DielectricInterface dielectric_interface(float cos_i, float eta) {
  const bool outside = cos_i >= 0;
  const float relative = outside ? eta : 1 / eta, inverse = outside ? 1 / eta : eta;
  const float c = std::abs(cos_i);
  const float t = safe_sqrt(1 - (1 - cos_i * cos_i) * inverse * inverse);
  float r;
  if (eta == 1) {
    r = 0;
  } else if (c == 0) {
    r = 1;
  } else {
    const float s = (c - relative * t) / (c + relative * t);
    const float p = (relative * c - t) / (relative * c + t);
    r = 0.5f * (s * s + p * p);
  }
  return {r, outside ? -t : t, relative};
}

/// Reflectance of a conductor with complex index (eta + i k) relative to the outside, for cos_i in [0,1]; one
/// wavelength.
inline float conductor_reflectance(float cos_i, float eta, float k) {
  const float c2 = cos_i * cos_i, s2 = 1 - c2;
  const float d = eta * eta - k * k - s2;
  const float m = safe_sqrt(d * d + 4 * k * k * eta * eta);
  const float a = safe_sqrt(0.5f * (m + d));
  const float rs = (m + c2 - 2 * cos_i * a) / (m + c2 + 2 * cos_i * a);
  const float q = c2 * m + s2 * s2, w = 2 * cos_i * a * s2;
  return 0.5f * (rs + rs * (q - w) / (q + w));
}

/// (1 - cos)^5 of Schlick's approximation.
inline float schlick_weight(float cos_i) {
  const float m = std::clamp(1 - cos_i, 0.0f, 1.0f), m2 = m * m;
  return m2 * m2 * m;
}
/// The same at an interface: the cosine on the side of the lower index counts, so that both directions agree. 1 under
/// total internal reflection.
inline float schlick_weight_interface(float cos_i, float eta) {
  const float relative = cos_i >= 0 ? eta : 1 / eta;
  if (relative > 1 || eta == 1) return schlick_weight(std::abs(cos_i));
  return schlick_weight(safe_sqrt(1 - (1 - cos_i * cos_i) / (relative * relative)));
}
/// Reflectance at normal incidence.
inline float reflectance_at_normal(float eta) { return sqr((eta - 1) / (eta + 1)); }

/// Hemispherical average of the reflectance seen from outside an interface of relative index `eta`: rational fits,
/// exact to 0.2 % for eta > 1 [d'Eon 2011] and to 0.6 % for 1 > eta > 0.5 [Egan 1973].
inline float diffuse_fresnel_reflectance(float eta) {
  const float i = 1 / eta;
  if (eta < 1) return 0.0636f * i + (eta * (eta * -1.4399f + 0.7099f) + 0.6681f);
  return 0.919317f + i * (-3.4793f + i * (6.75335f + i * (-7.80989f + i * (4.98554f - i * 1.36881f))));
}

struct ConductorFresnel {
  Rgb eta, k, scale;
  Rgb reflect(float c) const {
    c = std::abs(c);
    return scale * Rgb{conductor_reflectance(c, eta.r, k.r), conductor_reflectance(c, eta.g, k.g),
                       conductor_reflectance(c, eta.b, k.b)};
  }
};

struct DielectricFresnel {
  float eta;  ///< inside over outside
  Rgb reflectance, transmittance;
  Rgb reflect(float c) const { return reflectance * dielectric_interface(c, eta).reflectance; }
  Rgb transmit(float c) const { return transmittance * (1 - dielectric_interface(c, eta).reflectance); }
  float reflect_probability(float c) const { return dielectric_interface(c, eta).reflectance; }
};

/// Two parallel interfaces with all reflections between them; light leaves in the direction in which it came.
struct ThinFresnel {
  float eta;
  Rgb reflectance, transmittance;
  float total(float c) const {
    const float r = dielectric_interface(std::abs(c), eta).reflectance;
    return 2 * r / (1 + r);  // r + t r t + t r^3 t + ...
  }
  Rgb reflect(float c) const { return reflectance * total(c); }
  Rgb transmit(float c) const { return transmittance * (1 - total(c)); }
  float reflect_probability(float c) const { return total(c); }
};

/// Schlick's form for reflection and transmission with separate end points: f0 + (f90 - f0) (1 - cos)^5 is reflected,
/// transmittance * (1 - (loss0 + (loss90 - loss0) (1 - cos)^5)) is transmitted. `eta` bends and flips the interface.
struct SchlickFresnel {
  Rgb f0;
  float f90 = 1;
  Rgb transmittance;
  float loss0 = 1, loss90 = 1;
  float eta = 1;
  Rgb reflect(float c) const {
    const float s = schlick_weight_interface(c, eta);
    return f0 * (1 - s) + Rgb(f90 * s);
  }
  Rgb transmit(float c) const {
    const float s = schlick_weight_interface(c, eta);
    return transmittance * (1 - (loss0 * (1 - s) + loss90 * s));
  }
  float reflect_probability(float c) const {
    const float r = max_component(reflect(c)), t = max_component(transmit(c));
    return r + t > 0 ? r / (r + t) : 1;
  }
};

/// Fresnel term of Mitsuba's `principled`: dielectric, tinted dielectric and metal mixed outside, dielectric inside.
struct PrincipledFresnel {
  float eta;
  Rgb base_color;
  float metallic, spec_tint;
  float transmission;  ///< weight of the transmitting part: (1 - metallic) spec_trans
  Rgb reflect(float c) const {
    const float dielectric = dielectric_interface(c, eta).reflectance;
    if (c < 0) return Rgb(transmission * dielectric);
    Rgb f((1 - metallic) * (1 - spec_tint) * dielectric);
    if (metallic == 0 && spec_tint == 0) return f;
    const float s = schlick_weight_interface(c, eta);
    f += metallic * (base_color * (1 - s) + Rgb(s));
    if (spec_tint > 0) {
      f += (1 - metallic) * spec_tint * (tinted_f0() * (1 - s) + Rgb(s));
    }
    return f;
  }
  /// Reflectance at normal incidence in the hue of the base color.
  Rgb tinted_f0() const {
    const float y = luminance(base_color);
    return (y > 0 ? base_color / y : Rgb(1.0f)) * reflectance_at_normal(eta);
  }
  Rgb transmit(float c) const {
    return sqrt(base_color) * (transmission * (1 - dielectric_interface(c, eta).reflectance));
  }
  float reflect_probability(float c) const {
    const float dielectric = dielectric_interface(c, eta).reflectance;
    return c >= 0 ? 1 - transmission * (1 - dielectric) : dielectric;
  }
};

}  // namespace tempera
