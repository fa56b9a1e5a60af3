// SPDX-License-Identifier: Apache-2.0
#include "tempera/shading/bsdf.h"

#include <algorithm>
#include <cmath>

#include "albedo.h"

namespace tempera {
namespace {

Event event_of(float roughness, bool transmitted) {
  if (roughness >= kSpecularRoughness) return Event::kDiffuse;
  return transmitted ? Event::kTransmission : Event::kReflection;
}

float tan2(float cosine) {
  const float c2 = cosine * cosine;
  return std::max(1 - c2, 0.0f) / c2;
}

// Albedos of lobes by kind. `transmitted` selects the half of the sphere opposite wo.
Rgb lobe_albedo(const DiffuseLobe& l, const Vec3f& wo, bool transmitted) {
  return wo.z > 0 && !transmitted ? l.reflectance : Rgb(0.0f);
}
Rgb lobe_albedo(const SmoothPlasticLobe& l, const Vec3f& wo, bool transmitted) {
  if (wo.z <= 0 || transmitted) return Rgb(0.0f);
  return l.reflectance *
         ((1 - dielectric_interface(wo.z, l.eta).reflectance) * (1 - diffuse_fresnel_reflectance(l.eta)));
}
Rgb lobe_albedo(const RoughPlasticLobe& l, const Vec3f& wo, bool transmitted) {
  if (wo.z <= 0 || transmitted) return Rgb(0.0f);
  float exit = 0;  // cosine-weighted mean of the transmittance
  constexpr int kSteps = 16;
  for (int i = 0; i < kSteps; ++i) {
    const float c = (float(i) + 0.5f) / kSteps;
    exit += l.table->at(c) * 2 * c / kSteps;
  }
  return l.reflectance * (l.table->at(wo.z) * exit);
}
template <class F>
Rgb lobe_albedo(const MirrorLobe<F>& l, const Vec3f& wo, bool transmitted) {
  return transmitted ? Rgb(0.0f) : l.sample(wo).f;
}
template <class F>
Rgb lobe_albedo(const RefractionLobe<F>& l, const Vec3f& wo, bool transmitted) {
  return transmitted ? l.sample(wo).f : Rgb(0.0f);
}
template <class F>
Rgb lobe_albedo(const PassageLobe<F>& l, const Vec3f& wo, bool transmitted) {
  return transmitted ? l.sample(wo).f : Rgb(0.0f);
}
/// Rough lobes: mean over some visible normals m of `weight(m)`.
template <class F>
Rgb facet_mean(Microfacet facets, const Vec3f& wo, F&& weight) {
  constexpr int kNormals = 24;
  facets.sample_visible = true;
  Rgb sum;
  for (int i = 0; i < kNormals; ++i) sum += weight(facets.sample(wo, recurrence_point(i)));
  return sum / float(kNormals);
}
template <class L>
Rgb reflected_mean(const L& l, const Vec3f& up, float side) {
  return facet_mean(l.microfacet, up, [&](const Vec3f& m) {
    const Vec3f wi = mirror(up, m);
    return wi.z > 0 ? l.fresnel.reflect(side * dot(up, m)) * l.microfacet.g1(wi, m) : Rgb(0.0f);
  });
}
template <class F>
Rgb lobe_albedo(const MicrofacetReflectionLobe<F>& l, const Vec3f& wo, bool transmitted) {
  return wo.z > 0 && !transmitted ? reflected_mean(l, wo, 1) : Rgb(0.0f);
}
Rgb lobe_albedo(const MicrofacetReflectionLobe<SchlickFresnel>& l, const Vec3f& wo, bool transmitted) {
  if (wo.z <= 0 || transmitted) return Rgb(0.0f);
  const GgxAlbedo a = ggx_albedo(wo.z, std::sqrt(l.microfacet.alpha_u * l.microfacet.alpha_v));
  return l.fresnel.f0 * a.scale + Rgb(l.fresnel.f90 * a.bias);
}
template <class F>
Rgb lobe_albedo(const RoughInterfaceLobe<F>& l, const Vec3f& wo, bool transmitted) {
  if (wo.z == 0) return Rgb(0.0f);
  const float side = wo.z > 0 ? 1.0f : -1.0f;
  const Vec3f up = wo * side;
  if (!transmitted) return reflected_mean(l, up, side);
  return facet_mean(l.microfacet, up, [&](const Vec3f& m) {
    const float om = side * dot(up, m);
    const DielectricInterface face = dielectric_interface(om, l.fresnel.eta);
    const Vec3f wi = m * (side * om / face.eta + side * face.cos_t) - up * (1 / face.eta);
    return wi.z < 0 ? l.fresnel.transmit(om) * (l.microfacet.g1(wi, m) / (face.eta * face.eta)) : Rgb(0.0f);
  });
}
template <class F>
Rgb lobe_albedo(const RoughPassageLobe<F>& l, const Vec3f& wo, bool transmitted) {
  if (wo.z == 0 || !transmitted) return Rgb(0.0f);
  const Vec3f up{wo.x, wo.y, std::abs(wo.z)};
  return facet_mean(l.microfacet, up, [&](const Vec3f& m) {
    const Vec3f wi = mirror(up, m);
    return wi.z > 0 ? l.fresnel.transmit(dot(up, m)) * l.microfacet.g1(wi, m) : Rgb(0.0f);
  });
}
Rgb lobe_albedo(const PrincipledDiffuseLobe& l, const Vec3f& wo, bool transmitted) {
  return wo.z > 0 && !transmitted ? l.base_color : Rgb(0.0f);
}
Rgb lobe_albedo(const ClearcoatLobe& l, const Vec3f& wo, bool transmitted) {
  return wo.z > 0 && !transmitted ? Rgb(l.weight * (0.04f + 0.96f * schlick_weight(wo.z))) : Rgb(0.0f);
}
Rgb lobe_albedo(const SheenLobe& l, const Vec3f& wo, bool transmitted) {
  return wo.z > 0 && !transmitted ? l.color * sheen_albedo(wo.z, l.alpha) : Rgb(0.0f);
}

}  // namespace

int Bsdf::add_frame(const Basis& frame) {
  for (int i = 0; i < frames_.size(); ++i) {
    const Frame& f = frames_[i];
    if (f.parent < 0 && f.basis.n == frame.n && f.basis.s == frame.s) return i;
  }
  return frames_.push_made([&] { return Frame{frame, 0, 1, -1}; });
}

int Bsdf::add_perturbed_frame(const Basis& frame, int parent) {
  return frames_.push(
      {frame, std::min(0.125f * tan2(dot(frame.n, frames_[parent].basis.n)), 1.0f), 1, std::int8_t(parent)});
}

int Bsdf::add_flipped_frame(int index) {
  Frame f = frames_[index];
  f.basis.n = -f.basis.n;
  if (f.parent < 0) return add_frame(f.basis);
  f.orientation = -f.orientation;
  return frames_.push(f);
}

int Bsdf::add_rotated_frame(int index, const Vec2f& direction) {
  Frame f = frames_[index];
  const Basis b = f.basis;
  f.basis.s = b.s * direction.x + b.t * direction.y;
  f.basis.t = b.t * direction.x - b.s * direction.y;
  return f.parent < 0 ? add_frame(f.basis) : frames_.push(f);
}

int Bsdf::add_layer(const BsdfLayer& layer) { return layers_.push(layer); }

/// Zero if wi is on different sides of a perturbed normal and its parent's, else the bump shadowing term.
float Bsdf::frame_factor(const Frame& frame, const Vec3f& wi) const {
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

float Bsdf::layer_factor(int layer, const Vec3f& wo, const Vec3f& wi) const {
  float factor = 1;
  for (; layer >= 0; layer = layers_[layer].above) {
    const BsdfLayer& l = layers_[layer];
    const Vec3f& n = frames_[l.frame].basis.n;
    const auto albedo = [&](float c) {
      switch (l.albedo) {
        case BsdfLayer::Albedo::kFresnel:
          return l.f0 + (l.f90 - l.f0) * schlick_weight(std::abs(c));
        case BsdfLayer::Albedo::kGgx:
          return ggx_albedo(c, l.alpha).of(l.f0, l.f90);
        case BsdfLayer::Albedo::kSheen:
          return l.f0 * sheen_albedo(std::abs(c), l.alpha);
      }
      return 0.0f;
    };
    factor *= std::max(1 - std::max(albedo(dot(n, wo)), albedo(dot(n, wi))), 0.0f);
  }
  return factor;
}

/// Adds one non-delta lobe; wo and wi are given in the world and in the lobe's frame.
template <class L>
TEMPERA_INLINE void Bsdf::accumulate(const L& lobe, const Entry& entry, const Vec3f& wo, const Vec3f& wi,
                                     const Vec3f& local_wo, const Vec3f& local_wi, BsdfEval& out) const {
  const LobeEval e = lobe.eval(local_wo, local_wi);
  if (!(e.pdf > 0)) return;
  float weight = entry.weight;
  const Frame& frame = frames_[entry.frame];
  if (frame.parent >= 0) {
    const float factor = frame_factor(frame, wi);
    if (factor == 0) return;
    weight *= factor;
  }
  if (entry.layer >= 0) weight *= layer_factor(entry.layer, wo, wi);
  out.f_cos[std::size_t(event_of(lobe.roughness(), local_wo.z * local_wi.z < 0))] += e.f_cos * weight;
  out.pdf += e.pdf * entry.probability;
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
      if (frame.parent >= 0) weight *= frame_factor(frame, out.wi);
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

Rgb Bsdf::albedo(const Vec3f& wo, Event event) const {
  Rgb sum;
  for (int i = 0; i < lobes_.size(); ++i) {
    const Entry& entry = lobes_[i];
    const Vec3f o = frames_[entry.frame].basis.to_local(wo);
    visit_lobe(entry.lobe, [&](const auto& lobe) {
      // How much a layer lets pass depends on wi: take the mirror direction, or the mean cosine 2/3 of a diffuse lobe.
      const bool diffuse = std::is_base_of_v<CosineSampled, std::decay_t<decltype(lobe)>>;
      const Vec3f wi = diffuse ? frames_[entry.frame].basis.to_world({0.745356f, 0, 0.666667f}) : wo;
      const float weight = entry.weight * layer_factor(entry.layer, wo, wi);
      for (const bool transmitted : {false, true})
        if (event_of(lobe.roughness(), transmitted) == event) sum += lobe_albedo(lobe, o, transmitted) * weight;
    });
  }
  return sum;
}

}  // namespace tempera
