// SPDX-License-Identifier: Apache-2.0
// A BSDF without its diffuse lobes and deltas: what light that is focused takes part in. Apart from bsdf.cpp, as the compiler
// would inline less of what every path needs if it stood there.
#include <algorithm>

#include "bsdf_accumulate.h"

namespace tempera {

namespace {
/// Whether a lobe is near-specular without being a delta.
bool is_near_specular(const Lobe& lobe) {
  bool result = false;
  visit_lobe(lobe, [&](const auto& l) { result = !l.kDelta && l.roughness() < kSpecularRoughness; });
  return result;
}
}  // namespace

bool Bsdf::has_near_specular() const {
  for (const Entry& e : lobes_) {
    if (is_near_specular(e.lobe)) return true;
  }
  return false;
}

bool Bsdf::has_diffuse() const {
  for (int i = 0; i < lobes_.size(); ++i) {
    if (!is_delta(i) && !is_near_specular(lobes_[i].lobe)) return true;
  }
  return false;
}

float Bsdf::near_specular_probability() const {
  float sum = 0;
  for (const Entry& e : lobes_) {
    if (is_near_specular(e.lobe)) sum += e.probability;
  }
  return sum;
}

BsdfEval Bsdf::eval_near_specular(const Vec3f& wo, const Vec3f& wi) const {
  BsdfEval out;
  for (const Entry& entry : lobes_) {
    if (!is_near_specular(entry.lobe)) continue;
    visit_lobe(entry.lobe, [&](const auto& lobe) {
      if constexpr (!std::decay_t<decltype(lobe)>::kDelta) {
        const Basis& basis = frames_[entry.frame].basis;
        accumulate(lobe, entry, wo, wi, basis.to_local(wo), basis.to_local(wi), out);
      }
    });
  }
  if (out.pdf > 0) out.pdf /= near_specular_probability();
  return out;
}

std::optional<BsdfSample> Bsdf::sample_near_specular(const Vec3f& wo, float u_lobe, const Vec2f& u) const {
  float rest = u_lobe * near_specular_probability();
  int chosen = -1;
  for (int i = 0; i < lobes_.size(); ++i) {
    if (!is_near_specular(lobes_[i].lobe)) continue;
    if (chosen >= 0) rest -= lobes_[chosen].probability;
    chosen = i;
    if (rest < lobes_[i].probability) break;
  }
  if (chosen < 0) return std::nullopt;
  const Entry& entry = lobes_[chosen];
  const Basis& basis = frames_[entry.frame].basis;
  const Vec3f o = basis.to_local(wo);
  BsdfSample out;
  bool found = false;
  visit_lobe(entry.lobe, [&](const auto& lobe) {
    using L = std::decay_t<decltype(lobe)>;
    if constexpr (!L::kDelta) {
      Vec3f local;
      if (!lobe.sample(o, std::clamp(rest / entry.probability, 0.0f, 0x1.fffffep-1f), u, local)) return;
      found = true;
      out.wi = basis.to_world(local);
      out.transmitted = local.z * o.z < 0;
      out.roughness = lobe.roughness();
      out.event = event_of(out.roughness, out.transmitted);
      if constexpr (requires { L::kRefracts; })
        if (out.transmitted) out.eta = o.z > 0 ? lobe.fresnel.eta : 1 / lobe.fresnel.eta;
    }
  });
  if (!found) return std::nullopt;
  out.lobe = chosen;
  static_cast<BsdfEval&>(out) = eval_near_specular(wo, out.wi);
  if (!(out.pdf > 0 && out.pdf < kInfinity)) return std::nullopt;
  return out;
}

}  // namespace tempera
