// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include "material_util.h"

namespace tempera {

void check_ior(const char* material, float int_ior, float ext_ior) {
  for (const float ior : {int_ior, ext_ior})
    if (!(ior > 0) || !std::isfinite(ior))
      throw Error(ErrorCode::kOutOfRange,
                  fmt::format("{}: index of refraction {} must be positive and finite", material, ior));
}

namespace {

class Dielectric final : public Material {
 public:
  explicit Dielectric(const DielectricParams& params) : p_(params), eta_(params.int_ior / params.ext_ior) {}

  void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const override {
    const int frame = frame_of(point, bsdf);
    const DielectricFresnel fresnel{eta_, p_.specular_reflectance.rgb(point), p_.specular_transmittance.rgb(point)};
    if (p_.roughness.rough && !p_.thin) {
      bsdf.add(frame, RoughInterfaceLobe<DielectricFresnel>{microfacet_of(p_.roughness, point), fresnel}, weight,
               weight);
      return;
    }
    // Interfaces keep the unbent normal; a probability of 0 from another one would lose light.
    const float cosine = point.bends ? dot(point.wo, point.unbent) : cos_wo(point);
    if (p_.thin) {
      const ThinFresnel thin{eta_, fresnel.reflectance, fresnel.transmittance};
      const float r = thin.reflect_probability(cosine);
      bsdf.add(frame, MirrorLobe<ThinFresnel>{thin, true}, weight * r, weight);
      bsdf.add(frame, PassageLobe<ThinFresnel>{thin}, weight * (1 - r), weight);
    } else {
      const float r = fresnel.reflect_probability(cosine);
      bsdf.add(frame, MirrorLobe<DielectricFresnel>{fresnel, true}, weight * r, weight);
      bsdf.add(frame, RefractionLobe<DielectricFresnel>{fresnel}, weight * (1 - r), weight);
    }
  }
  bool needs_tangents() const override { return is_anisotropic(p_.roughness); }
  bool needs_footprint() const override {
    return any_texture(p_.roughness) || any_texture({&p_.specular_reflectance, &p_.specular_transmittance});
  }
  int max_lobes() const override { return 2; }

 private:
  DielectricParams p_;
  float eta_;
};

}  // namespace

MaterialPtr make_dielectric(const DielectricParams& params) {
  check_ior("dielectric", params.int_ior, params.ext_ior);
  return std::make_shared<Dielectric>(params);
}

}  // namespace tempera
