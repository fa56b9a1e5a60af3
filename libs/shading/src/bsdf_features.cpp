// SPDX-License-Identifier: Apache-2.0
// What feature layers ask of a Bsdf, apart from what transport asks.
#include "tempera/shading/bsdf.h"

namespace tempera {

Rgb Bsdf::diffuse_albedo(const Vec3f& wo, const Rgb* all) const {
  int specular = 0;
  const auto is_specular = [](const Entry& e) {
    bool specular_lobe = false;
    visit_lobe(e.lobe, [&](const auto& lobe) {
      specular_lobe = std::decay_t<decltype(lobe)>::kDelta || lobe.roughness() < kSpecularRoughness;
    });
    return specular_lobe;
  };
  for (const Entry& e : lobes_) specular += is_specular(e);
  if (specular == 0) return all ? *all : albedo(wo);
  if (specular == lobes_.size()) return Rgb(0.0f);
  Bsdf diffuse = *this;
  diffuse.lobes_.clear();
  for (const Entry& e : lobes_) {
    if (!is_specular(e)) diffuse.lobes_.push(e);
  }
  return diffuse.albedo(wo);
}

}  // namespace tempera
