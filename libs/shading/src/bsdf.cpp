// SPDX-License-Identifier: Apache-2.0
#include "tempera/shading/bsdf.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "albedo.h"
#include "bsdf_accumulate.h"
#include "tempera/shading/shading_normal.h"

namespace tempera {
namespace {

float tan2(float cosine) {
  const float c2 = cosine * cosine;
  return std::max(1 - c2, 0.0f) / c2;
}

// Directional albedos of lobes, in terms of power.
float mean_alpha(const Microfacet& m) { return std::sqrt(m.alpha_u * m.alpha_v); }
AlbedoEntry interface_albedo(AlbedoOf of, const Microfacet& facets, float eta, const Vec3f& wo) {
  return albedo_of({of, facets.type, wo.z > 0 ? eta : 1 / eta}, wo.z, mean_alpha(facets));
}

Rgb lobe_albedo(const DiffuseLobe& l, const Vec3f& wo) { return wo.z > 0 ? l.reflectance : Rgb(0.0f); }
Rgb lobe_albedo(const SmoothPlasticLobe& l, const Vec3f& wo) {
  if (wo.z <= 0) return Rgb(0.0f);
  return l.reflectance *
         ((1 - dielectric_interface(wo.z, l.eta).reflectance) * (1 - diffuse_fresnel_reflectance(l.eta)));
}
Rgb lobe_albedo(const RoughPlasticLobe& l, const Vec3f& wo) {
  return wo.z > 0 ? l.reflectance * (l.table->at(wo.z) * l.table->mean) : Rgb(0.0f);
}
template <class F>
Rgb lobe_albedo(const MirrorLobe<F>& l, const Vec3f& wo) {
  return l.sample(wo).f;
}
template <class F>
Rgb lobe_albedo(const RefractionLobe<F>& l, const Vec3f& wo) {
  const DeltaSample s = l.sample(wo);
  return s.f * (s.eta * s.eta);
}
template <class F>
Rgb lobe_albedo(const PassageLobe<F>& l, const Vec3f& wo) {
  return l.sample(wo).f;
}
Rgb lobe_albedo(const MicrofacetReflectionLobe<ConductorFresnel>& l, const Vec3f& wo) {
  if (wo.z <= 0) return Rgb(0.0f);
  const AlbedoEntry e = interface_albedo(AlbedoOf::kFacets, l.microfacet, 1, wo);
  return l.fresnel.reflect(std::min(e[1] / e[0], 1.0f)) * e[0];  // at the facets' mean cosine
}
Rgb lobe_albedo(const MicrofacetReflectionLobe<DielectricFresnel>& l, const Vec3f& wo) {
  if (wo.z <= 0) return Rgb(0.0f);
  return l.fresnel.reflectance * interface_albedo(AlbedoOf::kFresnel, l.microfacet, l.fresnel.eta, wo)[1];
}
Rgb lobe_albedo(const MicrofacetReflectionLobe<SchlickFresnel>& l, const Vec3f& wo) {
  if (wo.z <= 0) return Rgb(0.0f);
  const GgxAlbedo a = ggx_albedo(wo.z, mean_alpha(l.microfacet));
  return l.fresnel.f0 * a.scale + Rgb(l.fresnel.f90 * a.bias);
}
Rgb lobe_albedo(const RoughInterfaceLobe<DielectricFresnel>& l, const Vec3f& wo) {
  const AlbedoEntry e = interface_albedo(AlbedoOf::kFresnel, l.microfacet, l.fresnel.eta, wo);
  return l.fresnel.reflectance * e[1] + l.fresnel.transmittance * e[2];
}
Rgb lobe_albedo(const RoughInterfaceLobe<SchlickFresnel>& l, const Vec3f& wo) {
  const SchlickFresnel& f = l.fresnel;
  const AlbedoEntry e = interface_albedo(AlbedoOf::kSchlick, l.microfacet, f.eta, wo);
  return f.f0 * e[0] + Rgb(f.f90 * e[1]) + f.transmittance * ((1 - f.loss0) * e[2] + (1 - f.loss90) * e[3]);
}
Rgb lobe_albedo(const RoughInterfaceLobe<PrincipledFresnel>& l, const Vec3f& wo) {
  const PrincipledFresnel& f = l.fresnel;
  const AlbedoEntry e = interface_albedo(AlbedoOf::kFresnel, l.microfacet, f.eta, wo);
  const Rgb transmitted = sqrt(f.base_color) * (f.transmission * e[2]);
  if (wo.z < 0) return transmitted + Rgb(f.transmission * e[1]);
  Rgb sum = transmitted + Rgb((1 - f.metallic) * (1 - f.spec_tint) * e[1]);
  if (f.metallic > 0 || f.spec_tint > 0) {
    const GgxAlbedo a = ggx_albedo(wo.z, mean_alpha(l.microfacet));
    sum += f.metallic * (f.base_color * a.scale + Rgb(a.bias)) +
           (1 - f.metallic) * f.spec_tint * (f.tinted_f0() * a.scale + Rgb(a.bias));
  }
  return sum;
}
Rgb lobe_albedo(const RoughPassageLobe<SchlickFresnel>& l, const Vec3f& wo) {
  const GgxAlbedo a = ggx_albedo(wo.z, mean_alpha(l.microfacet));
  return l.fresnel.transmittance * ((1 - l.fresnel.loss0) * a.scale + (1 - l.fresnel.loss90) * a.bias);
}
Rgb lobe_albedo(const PrincipledDiffuseLobe& l, const Vec3f& wo) {
  if (wo.z <= 0) return Rgb(0.0f);
  const AlbedoEntry e = albedo_of({AlbedoOf::kBurley}, wo.z, l.surface_roughness);
  return l.base_color * lerp(e[0], e[1], l.flatness) + l.sheen * e[2];
}
Rgb lobe_albedo(const ClearcoatLobe& l, const Vec3f& wo) {
  if (wo.z <= 0) return Rgb(0.0f);
  return Rgb(l.weight * albedo_of({AlbedoOf::kClearcoat, Microfacets::kGgx, l.eta}, wo.z, l.alpha)[0]);
}
Rgb lobe_albedo(const SheenLobe& l, const Vec3f& wo) {
  return wo.z > 0 ? l.color * sheen_albedo(wo.z, l.alpha) : Rgb(0.0f);
}

}  // namespace

Bsdf::Frame Bsdf::made_frame(const Basis& basis, const Vec3f& unbent) const {
  Frame f{basis, unbent, 0, 0, 1, -1, false};
  if (has_horizon_) {
    const float c = std::abs(dot(basis.n, horizon_));
    if (c < 1 - 1e-6f) f.n_ng = std::max(c, 1e-6f), f.attenuates = true;
  }
  return f;
}

int Bsdf::add_frame(const Basis& frame, const Vec3f& unbent) {
  const Frame made = made_frame(frame, unbent);
  for (int i = 0; i < frames_.size(); ++i) {
    const Frame& f = frames_[i];
    if (f.parent < 0 && f.basis.n == frame.n && f.basis.s == frame.s && f.n_ng == made.n_ng) return i;
  }
  return frames_.push(made);
}

int Bsdf::add_perturbed_frame(const Basis& frame, int parent, const Vec3f& unbent) {
  Frame f = made_frame(frame, unbent);
  f.shadow_alpha2 = std::min(0.125f * tan2(dot(unbent, frames_[parent].unbent)), 1.0f);
  f.parent = std::int8_t(parent);
  f.attenuates = true;
  return frames_.push(f);
}

/// Frame `index` as it was before its normal was bent, and without the horizon.
int Bsdf::unbent_frame(int index) {
  Frame f = frames_[index];
  if (f.n_ng == 0 && f.basis.n == f.unbent) return index;
  f.basis = with_normal(f.basis, f.unbent);
  f.n_ng = 0;
  f.attenuates = f.parent >= 0;
  for (int i = 0; i < frames_.size(); ++i) {
    const Frame& known = frames_[i];
    if (known.n_ng == 0 && known.parent == f.parent && known.basis.n == f.basis.n && known.basis.s == f.basis.s)
      return i;
  }
  return frames_.push(f);
}

int Bsdf::add_flipped_frame(int index) {
  Frame f = frames_[index];
  f.basis.n = -f.basis.n;
  f.unbent = -f.unbent;
  if (f.parent < 0) return add_frame(f.basis, f.unbent);
  f.orientation = -f.orientation;
  return frames_.push(f);
}

int Bsdf::add_rotated_frame(int index, const Vec2f& direction) {
  Frame f = frames_[index];
  const Basis b = f.basis;
  f.basis.s = b.s * direction.x + b.t * direction.y;
  f.basis.t = b.t * direction.x - b.s * direction.y;
  return f.parent < 0 ? add_frame(f.basis, f.unbent) : frames_.push(f);
}

int Bsdf::add_layer(const BsdfLayer& layer) { return layers_.push(layer); }

/// Fades light out at the horizon. Without one: zero if wi is on different sides of a perturbed normal and its
/// parent's, else the bump shadowing term.
float Bsdf::frame_factor(const Frame& frame, const Vec3f& wi, float roughness) const {
  if (frame.n_ng > 0) return terminator_factor(dot(horizon_, wi), dot(frame.basis.n, wi), frame.n_ng, roughness);
  float factor = 1;
  for (const Frame* f = &frame; f->parent >= 0;) {
    const Frame& parent = frames_[f->parent];
    const float c = dot(wi, parent.basis.n);
    if (!(f->orientation * parent.orientation * c * dot(wi, f->basis.n) > 0)) return 0;
    factor *= 2 / (1 + std::sqrt(1 + f->shadow_alpha2 * tan2(c)));
    f = &parent;
  }
  return factor;
}

namespace {
/// What a layer keeps from what lies below it, of light at cosine c to its normal.
TEMPERA_INLINE float layer_albedo(const BsdfLayer& l, float c) {
  switch (l.albedo) {
    case BsdfLayer::Albedo::kFresnel:
      return l.f0 + (l.f90 - l.f0) * schlick_weight(std::abs(c));
    case BsdfLayer::Albedo::kGgx:
      return ggx_albedo(c, l.alpha).of(l.f0, l.f90);
    case BsdfLayer::Albedo::kSheen:
      return l.f0 * sheen_albedo(std::abs(c), l.alpha);
  }
  return 0.0f;
}
}  // namespace

float Bsdf::layer_factor(int layer, const Vec3f& wo, const Vec3f& wi) const {
  float factor = 1;
  for (; layer >= 0; layer = layers_[layer].above) {
    const BsdfLayer& l = layers_[layer];
    const Vec3f& n = frames_[l.frame].basis.n;
    factor *= std::max(1 - std::max(layer_albedo(l, dot(n, wo)), layer_albedo(l, dot(n, wi))), 0.0f);
  }
  return factor;
}

float Bsdf::mean_layer_factor(int layer, const Vec3f& wo, const Basis& basis) const {
  constexpr int kCosines = 4;
  std::array<float, kCosines> factors;
  factors.fill(1);
  std::array<Vec3f, kCosines> directions;
  for (int k = 0; k < kCosines; ++k) {
    const float c2 = (float(k) + 0.5f) / kCosines;
    directions[k] = basis.to_world({std::sqrt(1 - c2), 0, std::sqrt(c2)});
  }
  for (; layer >= 0; layer = layers_[layer].above) {
    const BsdfLayer& l = layers_[layer];
    const Vec3f& n = frames_[l.frame].basis.n;
    const float out = layer_albedo(l, dot(n, wo));
    for (int k = 0; k < kCosines; ++k)
      factors[k] *= std::max(1 - std::max(out, layer_albedo(l, dot(n, directions[k]))), 0.0f);
  }
  float mean = 0;
  for (const float f : factors) mean += f / kCosines;
  return mean;
}

void Bsdf::accumulate_all(const Vec3f& wo, const Vec3f& wi, int skip, BsdfEval& out) const {
  for (int i = 0; i < lobes_.size(); ++i) {
    if (i == skip) continue;
    const Entry& entry = lobes_[i];
    visit_lobe(entry.lobe, [&](const auto& lobe) {
      if constexpr (!std::decay_t<decltype(lobe)>::kDelta) {
        const Basis& basis = frames_[entry.frame].basis;
        accumulate(lobe, entry, wo, wi, basis.to_local(wo), basis.to_local(wi), out);
      }
    });
  }
}

BsdfEval Bsdf::eval(const Vec3f& wo, const Vec3f& wi) const {
  BsdfEval out;
  accumulate_all(wo, wi, -1, out);
  if (out.pdf > 0) out.pdf /= total_probability_;
  return out;
}

std::optional<BsdfSample> Bsdf::sample(const Vec3f& wo, float u_lobe, const Vec2f& u) const {
  std::optional<BsdfSample> result;
  if (lobes_.size() == 0) return result;
  // Choose a lobe; what is left of u_lobe is uniform again.
  float rest = u_lobe * total_probability_;
  int chosen = 0;
  while (chosen + 1 < lobes_.size() && rest >= lobes_[chosen].probability) rest -= lobes_[chosen++].probability;
  const Entry& entry = lobes_[chosen];
  const float u_choice = std::min(rest / entry.probability, 0x1.fffffep-1f);

  const Frame& frame = frames_[entry.frame];
  const Vec3f o = frame.basis.to_local(wo);
  BsdfSample& out = result.emplace();
  out.lobe = chosen;
  bool delta = false;
  visit_lobe(entry.lobe, [&](const auto& lobe) {
    using L = std::decay_t<decltype(lobe)>;
    if constexpr (L::kDelta) {
      delta = true;
    } else {
      Vec3f local;
      if (!lobe.sample(o, u_choice, u, local)) return;
      out.wi = frame.basis.to_world(local);
      out.transmitted = local.z * o.z < 0;
      out.roughness = lobe.roughness();
      out.event = event_of(out.roughness, out.transmitted);
      if constexpr (requires { L::kRefracts; })
        if (out.transmitted) out.eta = o.z > 0 ? lobe.fresnel.eta : 1 / lobe.fresnel.eta;
      accumulate(lobe, entry, wo, out.wi, o, local, out);
      if (lobes_.size() > 1) accumulate_all(wo, out.wi, chosen, out);
    }
  });
  if (delta) {
    result = sample_delta(chosen, wo);
    return result;
  }
  const bool valid = out.pdf > 0 && out.pdf < kInfinity;
  out.pdf /= total_probability_;
  if (!valid) result.reset();
  return result;
}

std::optional<BsdfSample> Bsdf::sample_delta(int i, const Vec3f& wo) const {
  const Entry& entry = lobes_[i];
  const Frame& frame = frames_[entry.frame];
  const Vec3f o = frame.basis.to_local(wo);
  BsdfSample out;
  float weight = 0;
  visit_lobe(entry.lobe, [&](const auto& lobe) {
    if constexpr (std::decay_t<decltype(lobe)>::kDelta) {
      const DeltaSample s = lobe.sample(o);
      if (!s.valid) return;
      out.wi = frame.basis.to_world(s.wi);
      weight = entry.weight;
      if (frame.attenuates) weight *= frame_factor(frame, out.wi, 0);
      if (entry.layer >= 0) weight *= layer_factor(entry.layer, wo, out.wi);
      out.transmitted = s.wi.z * o.z < 0;
      out.event = event_of(0, out.transmitted);
      out.f_cos[std::size_t(out.event)] = s.f * weight;
      out.pdf = entry.probability / total_probability_;
      out.delta = true;
      out.eta = s.eta;
      out.roughness = 0;
      out.lobe = i;
    }
  });
  return weight > 0 ? std::optional(out) : std::nullopt;
}

bool Bsdf::is_delta(int i) const {
  bool delta = false;
  visit_lobe(lobes_[i].lobe, [&](const auto& lobe) { delta = lobe.kDelta; });
  return delta;
}

float Bsdf::least_roughness() const {
  float least = kInfinity;
  for (int i = 0; i < lobes_.size(); ++i) {
    visit_lobe(lobes_[i].lobe, [&](const auto& lobe) {
      if (!lobe.kDelta) least = std::min(least, lobe.roughness());
    });
  }
  return least;
}

float Bsdf::rough_eta(const Vec3f& wo) const {
  float eta = 0;
  for (int i = 0; i < lobes_.size() && eta == 0; ++i) {
    const float cosine = dot(frames_[lobes_[i].frame].basis.n, wo);
    visit_lobe(lobes_[i].lobe, [&]<class L>(const L& lobe) {
      if constexpr (requires { L::kRefracts; }) {
        eta = cosine > 0 ? lobe.fresnel.eta : 1 / lobe.fresnel.eta;
      } else if constexpr (requires { L::kPasses; }) {
        eta = 1;
      }
    });
  }
  return eta;
}

Rgb Bsdf::albedo(const Vec3f& wo) const {
  Rgb sum;
  for (int i = 0; i < lobes_.size(); ++i) {
    const Entry& entry = lobes_[i];
    const Basis& basis = frames_[entry.frame].basis;
    visit_lobe(entry.lobe, [&](const auto& lobe) {
      float weight = entry.weight;
      if (entry.layer >= 0) {
        // How much a layer lets pass depends on wi, too: the mirror direction, or all around for a diffuse lobe.
        if constexpr (std::is_base_of_v<CosineSampled, std::decay_t<decltype(lobe)>>) {
          weight *= mean_layer_factor(entry.layer, wo, basis);
        } else {
          weight *= layer_factor(entry.layer, wo, wo);
        }
      }
      sum += lobe_albedo(lobe, basis.to_local(wo)) * weight;
    });
  }
  return sum;
}

}  // namespace tempera
