// SPDX-License-Identifier: Apache-2.0
#include "material_util.h"

namespace tempera {
namespace {

class Principled final : public Material {
 public:
  explicit Principled(const PrincipledParams& params) : p_(params) {
    transmits_ = !(p_.spec_trans.is_constant() && p_.spec_trans.factor.at(0).r == 0);
    if (transmits_ && p_.eta == 1) p_.eta = 1.001f;  // an interface that bends nothing has no half vectors
  }

  void add_lobes(const ShadingPoint& point, float weight, Bsdf& bsdf) const override {
    const float cosine = cos_wo(point);
    const float metallic = p_.metallic.scalar(point);
    const float spec_trans = transmits_ ? p_.spec_trans.scalar(point) : 0;
    const float transmission = (1 - metallic) * spec_trans, opaque = (1 - metallic) * (1 - spec_trans);
    const bool front = cosine > 0;
    if (cosine == 0 || (!front && transmission <= 0)) return;

    const int frame = frame_of(point, bsdf);
    const Rgb base = p_.base_color.rgb(point);
    const float roughness = p_.roughness.scalar(point);
    const float aspect = std::sqrt(1 - 0.9f * p_.anisotropic.scalar(point));
    const Microfacet facets(Microfacets::kGgx, std::max(0.001f, roughness * roughness / aspect),
                            std::max(0.001f, roughness * roughness * aspect));
    const PrincipledFresnel fresnel{p_.eta, base, metallic, p_.spec_tint.scalar(point), transmission};
    const RoughInterfaceLobe<PrincipledFresnel> specular{facets, fresnel};
    if (!front) {
      bsdf.add(frame, specular, weight, weight);
      return;
    }
    // The coat carries a quarter of the main reflection's energy.
    const float coat = 0.25f * p_.clearcoat.scalar(point);
    const float scale = weight / (1 + std::max(coat, 0.0f) + std::max(opaque, 0.0f));
    bsdf.add(frame, specular, scale, weight);
    if (opaque > 0) {
      PrincipledDiffuseLobe diffuse;
      diffuse.base_color = base * opaque;
      diffuse.surface_roughness = roughness;
      diffuse.flatness = p_.flatness.scalar(point);
      const float sheen = p_.sheen.scalar(point) * (1 - metallic);
      if (sheen > 0) {
        const float y = luminance(base);
        const Rgb tint = y > 0 ? base / y : Rgb(1.0f);
        diffuse.sheen = sheen * lerp(Rgb(1.0f), tint, p_.sheen_tint.scalar(point));
      }
      bsdf.add(frame, diffuse, scale * opaque, weight);
    }
    if (coat > 0) {
      const float gloss = p_.clearcoat_gloss.scalar(point);
      bsdf.add(frame, ClearcoatLobe{coat, 0.1f + gloss * (0.001f - 0.1f), p_.eta}, scale * coat, weight);
    }
  }
  bool needs_tangents() const override { return !(p_.anisotropic.is_constant() && p_.anisotropic.factor.at(0).r == 0); }
  bool needs_footprint() const override {
    return any_texture({&p_.base_color, &p_.roughness, &p_.anisotropic, &p_.metallic, &p_.spec_trans, &p_.spec_tint,
                        &p_.sheen, &p_.sheen_tint, &p_.flatness, &p_.clearcoat, &p_.clearcoat_gloss});
  }
  int max_lobes() const override { return 3; }

 private:
  PrincipledParams p_;
  bool transmits_;
};

}  // namespace

MaterialPtr make_principled(const PrincipledParams& params) {
  check_ior("principled", params.eta, 1);
  return std::make_shared<Principled>(params);
}

namespace {
MaterialPtr principled_from(const MaterialValues& v) {
  PrincipledParams p;
  p.base_color = v.color_slot("base_color");
  p.roughness = v.scalar_slot("roughness");
  p.anisotropic = v.scalar_slot("anisotropic");
  p.metallic = v.scalar_slot("metallic");
  p.spec_trans = v.scalar_slot("spec_trans");
  p.spec_tint = v.scalar_slot("spec_tint");
  p.sheen = v.scalar_slot("sheen");
  p.sheen_tint = v.scalar_slot("sheen_tint");
  p.flatness = v.scalar_slot("flatness");
  p.clearcoat = v.scalar_slot("clearcoat");
  p.clearcoat_gloss = v.scalar_slot("clearcoat_gloss");
  p.eta = float(v.params().get_double("eta"));
  return make_principled(p);
}
}  // namespace

extern const MaterialEntry principled_material;
const MaterialEntry principled_material{"principled",
                                        "Mitsuba's principled material",
                                        {{"base_color", "0.5", "color or image"},
                                         {"roughness", "0.5", "perceptual roughness in [0,1], or an image"},
                                         {"anisotropic", "0", "in [0,1]"},
                                         {"metallic", "0", "in [0,1], or an image"},
                                         {"spec_trans", "0", "specular transmission in [0,1]"},
                                         {"spec_tint", "0", "in [0,1]"},
                                         {"sheen", "0", "in [0,1]"},
                                         {"sheen_tint", "0", "in [0,1]"},
                                         {"flatness", "0", "in [0,1]"},
                                         {"clearcoat", "0", "in [0,1]"},
                                         {"clearcoat_gloss", "0", "in [0,1]"},
                                         {"eta", 1.5, "index of refraction relative to the outside", 1, 5}},
                                        principled_from};

}  // namespace tempera
