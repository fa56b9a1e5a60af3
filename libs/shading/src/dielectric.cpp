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

namespace {
MaterialPtr dielectric_from(const MaterialValues& v) {
  DielectricParams p;
  p.int_ior = float(v.params().get_double("int_ior"));
  p.ext_ior = float(v.params().get_double("ext_ior"));
  p.specular_reflectance = v.color_slot("reflectance");
  p.specular_transmittance = v.color_slot("transmittance");
  p.thin = v.params().get_bool("thin");
  p.roughness = roughness_from(v);
  if (p.thin && p.roughness.rough) {
    throw Error(ErrorCode::kBadInput, v.loc("roughness"), "a thin dielectric is smooth: roughness must be 0");
  }
  return make_dielectric(p);
}
}  // namespace

extern const MaterialEntry dielectric_material;
const MaterialEntry dielectric_material{
    "dielectric",
    "glass and other clear solids and liquids, smooth, thin or rough",
    {ior_param(1.5046),
     outer_ior_param(),
     {"reflectance", "1", "factor of the reflection: color or image"},
     {"transmittance", "1", "factor of the transmission: color or image"},
     {"thin", false, "two parallel interfaces without refraction between them, e.g. a pane"},
     roughness_param(),
     distribution_param()},
    dielectric_from};

}  // namespace tempera
