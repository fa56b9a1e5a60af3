// SPDX-License-Identifier: Apache-2.0
#pragma once
// How a lobe adds to the value of a BSDF: for the files that evaluate all lobes or some.
#include "tempera/shading/bsdf.h"

namespace tempera {

inline Event event_of(float roughness, bool transmitted) {
  if (roughness >= kSpecularRoughness) return Event::kDiffuse;
  return transmitted ? Event::kTransmission : Event::kReflection;
}

/// Adds one non-delta lobe; wo and wi are given in the world and in the lobe's frame.
template <class L>
TEMPERA_INLINE void Bsdf::accumulate(const L& lobe, const Entry& entry, const Vec3f& wo, const Vec3f& wi,
                                     const Vec3f& local_wo, const Vec3f& local_wi, BsdfEval& out) const {
  const LobeEval e = lobe.eval(local_wo, local_wi);
  if (!(e.pdf > 0)) return;
  out.pdf += e.pdf * entry.probability;  // also where the frame lets nothing pass: the lobe is sampled there
  float weight = entry.weight;
  const Frame& frame = frames_[entry.frame];
  if (frame.attenuates) {
    const float factor = frame_factor(frame, wi, lobe.roughness());
    if (factor == 0) return;
    weight *= factor;
  }
  if (entry.layer >= 0) weight *= layer_factor(entry.layer, wo, wi);
  out.f_cos[std::size_t(event_of(lobe.roughness(), local_wo.z * local_wi.z < 0))] += e.f_cos * weight;
}

}  // namespace tempera
