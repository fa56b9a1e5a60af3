// SPDX-License-Identifier: Apache-2.0
#pragma once
// What photons do in a shot, before it is rendered.
#include <optional>

#include "tempera/photons/photon_tracer.h"
#include "tempera/pipeline/shot.h"

namespace tempera {

/// Part of the pixels that caustics light noticeably: where a fifth of the light is theirs. The largest of the first, the
/// middle and the last frame of the shot's sequence, in small pictures of few samples: the same whichever frames are asked
/// for. 0 if nothing reflects or refracts sharply. Pre: shot.params are those of an integrator that has the parameter
/// `caustics`, and everything that the picture depends on is settled.
double caustics_coverage(const Scene& scene, const Shot& shot);

struct PhotonSurvey {
  int casters = 0;  ///< boxes of what reflects or refracts sharply
  PhotonCounts counts;
};
/// Traces the photons of the shot's first frame. Nothing if its integrator has none.
std::optional<PhotonSurvey> survey_photons(const Scene& scene, const Shot& shot);

}  // namespace tempera
