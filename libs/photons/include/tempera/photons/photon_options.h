// SPDX-License-Identifier: Apache-2.0
#pragma once
// What users choose of photons.
#include <string>
#include <vector>

#include "tempera/core/params.h"
#include "tempera/core/time.h"
#include "tempera/photons/footprint.h"

namespace tempera {

/// The instant of the exposure at which photons are traced.
enum class PhotonInstant : std::uint8_t { kMiddle, kOpen, kClose };
/// What is the same photon at another time. [Schjoth 2010, Sec. 3.2]
enum class PhotonGauge : std::uint8_t {
  kMatter,   ///< one that meets the same matter first, where that moves; else the same place and direction of the light
  kEmission  ///< always the same place and direction of the light, as published
};

struct PhotonOptions {
  std::int64_t photons = 0;           ///< emitted for a frame; 0: as many as go with the samples of the picture
  std::vector<std::string> lights{};  ///< names of the lights that emit; empty: those that are concentrated (LightAim)
  double overlap = 0;                 ///< footprints over a point where light is not focused; 0: by the number of photons
  SpatialKernel kernel = SpatialKernel::kEpanechnikov;
  Sweep sweep = Sweep::kLine;
  TimeFilter filter = TimeFilter::kBox;
  PhotonInstant instant = PhotonInstant::kMiddle;
  PhotonGauge gauge = PhotonGauge::kMatter;
  bool temporal = true;  ///< footprints move while the shutter is open; false: they stand where they are at the instant

  /// The parameters that set these, for tables of methods.
  static const std::vector<ParamSpec>& params();
  /// From parameters with those specifications; `temporal` is true if they say nothing of motion.
  explicit PhotonOptions(const Params& p);
  PhotonOptions() = default;

  /// Footprints over a point of the light of a lamp that emits n photons: area and number shrink and grow together, so that
  /// both bias and noise fall.
  double overlap_of(std::int64_t n) const;
  /// The instant within an exposure, s.
  double instant_of(const TimeSpan& exposure) const;
};

}  // namespace tempera
