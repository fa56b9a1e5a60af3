// SPDX-License-Identifier: Apache-2.0
#pragma once
// What users choose of photons.
#include <string>
#include <vector>

#include "tempera/core/params.h"
#include "tempera/core/time.h"
#include "tempera/photons/footprint.h"
#include "tempera/transport/settings.h"

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
  double overlap = 0;  ///< footprints over a point where light is not focused; 0: by the number of photons
  SpatialKernel kernel = SpatialKernel::kEpanechnikov;
  Sweep sweep = Sweep::kLine;
  TimeFilter filter = TimeFilter::kBox;
  PhotonInstant instant = PhotonInstant::kMiddle;
  PhotonGauge gauge = PhotonGauge::kMatter;
  bool discs = false;  ///< footprints are discs of one radius: plain photon mapping
  double radius = 0;   ///< of discs, m, or their largest one; 0: 1.25 % of the radius of the scene
  int nearest = 0;     ///< photons on the disc around a point that its light is estimated from; 0: discs of one radius
  int between =
      -1;  ///< discs are traced when the shutter opens, closes and so many times between; -1: at the instant alone
  int passes = 1;        ///< each emits `photons`, and has smaller footprints than the one before
  bool temporal = true;  ///< footprints move while the shutter is open; false: they stand where they are at the instant

  /// The parameters that set these, for tables of methods.
  static const std::vector<ParamSpec>& params();
  /// The same for plain photon mapping, and for photons of several instants. [Jensen 2001; Cammarano 2002]
  static std::vector<ParamSpec> disc_params(bool over_time);
  /// From parameters of one of those tables.
  explicit PhotonOptions(const Params& p);
  PhotonOptions() = default;

  /// Photons that are emitted for a frame, about.
  std::int64_t photons_for(const RenderSettings& settings) const;
  /// Footprints over a point of the light of a lamp that sends n photons to what focuses light: with more photons their
  /// number grows and their area shrinks, so that both bias and noise fall.
  double overlap_of(std::int64_t n) const;
  /// The instants within an exposure at which photons of a pass are traced, s. `whole`: as reach_of has it.
  std::vector<double> instants_of(const TimeSpan& exposure, int pass = 0, bool whole = false) const;
  /// Area of the footprints of a pass over those of the first, so that the mean of ever more passes converges.
  /// [Knaus 2011]
  static double area_scale(int pass);
  /// The part of an exposure that photons of a pass stand for: all of it in the first pass; then halves, each of them
  /// twice; then thirds, each of them three times; and so on. `whole`: always all of it.
  static TimeSpan reach_of(const TimeSpan& exposure, int pass, bool whole);
};

}  // namespace tempera
