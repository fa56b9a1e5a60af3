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

namespace {

/// The direction to which a smooth lobe in place of a rough one sends light from local `wo`, and the index of refraction
/// there over that on the side of wo; the direction is zero where it sends none.
struct SmoothDirection {
  Vec3f wi;
  float eta = 1;
};
template <class L>
SmoothDirection smooth_direction(const L& lobe, const Vec3f& wo, bool transmits) {
  if (wo.z == 0) return {};
  if (!transmits) return {{-wo.x, -wo.y, wo.z}, 1};
  if constexpr (requires { L::kPasses; }) return {-wo, 1};
  if constexpr (requires { L::kRefracts; }) {
    const DielectricInterface face = dielectric_interface(wo.z, lobe.fresnel.eta);
    if (face.cos_t != 0) return {{-wo.x / face.eta, -wo.y / face.eta, face.cos_t}, face.eta};
  }
  return {};
}

}  // namespace

std::optional<SpecularEvent> Bsdf::specular(Event event, const Vec3f& wo, const Vec3f& n) const {
  std::optional<SpecularEvent> best;
  for (int i = 0; i < size(); ++i) {
    const Basis& basis = frame(i);
    std::optional<SpecularEvent> found;
    visit_lobe(lobe(i), [&](const auto& l) {
      if constexpr (std::decay_t<decltype(l)>::kDelta) {
        const auto sample = sample_delta(i, wo);
        if (sample && !is_black(sample->f_cos[std::size_t(event)])) found = {sample->eta, basis.n};
      } else if (l.roughness() < kSpecularRoughness) {
        const SmoothDirection to = smooth_direction(l, basis.to_local(wo), event == Event::kTransmission);
        if (to.wi == Vec3f{}) return;
        if (!is_black(eval(wo, basis.to_world(to.wi)).f_cos[std::size_t(event)])) found = {to.eta, basis.n};
      }
    });
    if (found && (!best || std::abs(dot(found->n, n)) > std::abs(dot(best->n, n)))) best = found;
  }
  return best;
}

}  // namespace tempera
