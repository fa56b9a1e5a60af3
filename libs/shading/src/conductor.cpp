// SPDX-License-Identifier: Apache-2.0
#include "material_util.h"

namespace tempera {
namespace {

class Conductor final : public Material {
 public:
  explicit Conductor(const ConductorParams& params) : p_(params) {}
  void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const override {
    if (cos_wo(point) <= 0) return;
    const ConductorFresnel fresnel{p_.eta.rgb(point), p_.k.rgb(point), p_.specular_reflectance.rgb(point)};
    const int frame = frame_of(point, bsdf);
    if (p_.roughness.rough)
      bsdf.add(frame, MicrofacetReflectionLobe<ConductorFresnel>{microfacet_of(p_.roughness, point), fresnel}, weight,
               weight);
    else
      bsdf.add(frame, MirrorLobe<ConductorFresnel>{fresnel}, weight, weight);
  }
  bool needs_tangents() const override { return is_anisotropic(p_.roughness); }
  bool needs_footprint() const override {
    return any_texture(p_.roughness) || any_texture({&p_.eta, &p_.k, &p_.specular_reflectance});
  }

 private:
  ConductorParams p_;
};

}  // namespace

MaterialPtr make_conductor(const ConductorParams& params) { return std::make_shared<Conductor>(params); }

namespace {
MaterialPtr conductor_from(const MaterialValues& v) {
  ConductorParams p;
  p.eta = v.color_slot("eta");
  p.k = v.color_slot("k");
  p.specular_reflectance = v.color_slot("reflectance");
  p.roughness = roughness_from(v);
  return make_conductor(p);
}
}  // namespace

extern const MaterialEntry conductor_material;
const MaterialEntry conductor_material{"conductor",
                                       "metal, smooth or rough",
                                       {{"eta", "0", "real part of the index of refraction: number or three"},
                                        {"k", "1", "imaginary part; eta 0 and k 1 reflect everything"},
                                        {"reflectance", "1", "factor of the reflection: color or image"},
                                        roughness_param(),
                                        distribution_param()},
                                       conductor_from};

}  // namespace tempera
