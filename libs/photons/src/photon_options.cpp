// SPDX-License-Identifier: Apache-2.0
#include "tempera/photons/photon_options.h"

#include <algorithm>
#include <cmath>

namespace tempera {

namespace {

bool knows(const Params& p, const char* name) {
  return std::any_of(p.specs().begin(), p.specs().end(), [&](const ParamSpec& s) { return s.name == name; });
}

template <class E>
E chosen(const Params& p, const char* name) {
  for (const ParamSpec& s : p.specs()) {
    if (s.name != name) continue;
    const auto at = std::find(s.choices.begin(), s.choices.end(), p.get_string(name));
    return E(at - s.choices.begin());
  }
  return {};
}

}  // namespace

const std::vector<ParamSpec>& PhotonOptions::params() {
  static const std::vector<ParamSpec> specs = {
      {"photons", 0,
       "photons that the lights of a frame emit towards what focuses light; 0: as many as go with the samples", 0, 1e8},
      {"photon_lights", std::string(),
       "names of the lights that emit photons, separated by commas; empty: all lamps, and environments whose light "
       "comes from "
       "few directions"},
      {"overlap", 0.0, "footprints of photons over a point where light is not focused; 0: by the number of photons", 0,
       1e4},
      {"kernel",
       std::string("epanechnikov"),
       "how a photon's light is spread over its footprint",
       -1e300,
       1e300,
       {"uniform", "epanechnikov", "biweight", "gaussian"}},
      {"sweep",
       std::string("line"),
       "how moving footprints stand for the exposure: their exact mean, the nearest place of their way in the space of "
       "the "
       "kernel, or that in the world as published",
       -1e300,
       1e300,
       {"line", "clamped", "published"}},
      {"time_filter",
       std::string("box"),
       "how light counts from the photons' instant on",
       -1e300,
       1e300,
       {"box", "decay"}},
      {"instant",
       std::string("middle"),
       "the instant of the exposure at which photons are traced",
       -1e300,
       1e300,
       {"middle", "open", "close"}},
      {"gauge",
       std::string("matter"),
       "what photons stay with as time passes: the matter that they meet first, or their place and direction at the "
       "light "
       "as published",
       -1e300,
       1e300,
       {"matter", "emission"}},
      {"progressive", 1,
       "passes that each emit so many photons, with smaller footprints in each: ever finer caustics in the same memory",
       1, 10000},
  };
  return specs;
}

std::vector<ParamSpec> PhotonOptions::disc_params(bool over_time) {
  std::vector<ParamSpec> specs;
  for (const ParamSpec& s : params()) {
    if (s.name == "photons" || s.name == "photon_lights" || s.name == "kernel") specs.push_back(s);
  }
  specs.push_back(
      {"radius", 0.0, "radius in metres of the discs that photons light; 0: 1.25 % of the scene's", 0, 1e6});
  specs.push_back({"nearest", 0,
                   "photons that light is estimated from, those nearest to a point within the radius; 0: all within it",
                   0, 1e6});
  if (over_time) {
    specs.push_back({"between", 2,
                     "instants at which photons are traced beside the opening and the closing of the shutter", 0,
                     1000});
  }
  return specs;
}

PhotonOptions::PhotonOptions(const Params& p)
    : photons(p.get_int("photons")), kernel(chosen<SpatialKernel>(p, "kernel")), discs(knows(p, "radius")) {
  if (discs) {
    radius = p.get_double("radius");
    nearest = p.get_int("nearest");
    temporal = false;
    if (knows(p, "between")) between = p.get_int("between");
  } else {
    overlap = p.get_double("overlap");
    sweep = chosen<Sweep>(p, "sweep");
    filter = chosen<TimeFilter>(p, "time_filter");
    instant = chosen<PhotonInstant>(p, "instant");
    gauge = chosen<PhotonGauge>(p, "gauge");
    if (knows(p, "progressive")) passes = p.get_int("progressive");
  }
  const std::string& names = p.get_string("photon_lights");
  for (std::size_t at = 0; at < names.size();) {
    const std::size_t end = std::min(names.find(',', at), names.size());
    const std::size_t first = names.find_first_not_of(' ', at), last = names.find_last_not_of(' ', end - 1);
    if (end > at && first <= last && first < end) lights.push_back(names.substr(first, last - first + 1));
    at = end + 1;
  }
}

std::int64_t PhotonOptions::photons_for(const RenderSettings& s) const {
  if (photons > 0) return photons;
  // They take about as long as a quarter of the samples.
  const double samples = double(s.width) * double(s.height) * double(s.spp);
  return std::int64_t(std::clamp(samples / 16, 20000.0, 2e6));
}

double PhotonOptions::overlap_of(std::int64_t n) const {
  // Beyond 36 what is left of noise is below what anyone sees, and more footprints would only take time.
  return overlap > 0 ? overlap : std::min(9 * std::sqrt(std::max(1.0, double(n) / 1000)), 36.0);
}

std::vector<double> PhotonOptions::instants_of(const TimeSpan& exposure, int pass, bool whole) const {
  if (between >= 0) {
    std::vector<double> all(std::size_t(between) + 2);
    for (int i = 0; i < between + 2; ++i) all[i] = exposure.begin + exposure.length() * i / (between + 1);
    return all;
  }
  const TimeSpan reach = reach_of(exposure, pass, whole);
  switch (instant) {
    case PhotonInstant::kOpen:
      return {reach.begin};
    case PhotonInstant::kClose:
      return {reach.end};
    default:
      return {0.5 * (reach.begin + reach.end)};
  }
}

double PhotonOptions::area_scale(int pass) {
  constexpr double kAlpha = 0.75;
  double scale = 1;
  for (int i = 1; i <= pass; ++i) scale *= (i + kAlpha) / (i + 1);
  return scale;
}

TimeSpan PhotonOptions::reach_of(const TimeSpan& exposure, int pass, bool whole) {
  if (whole) return exposure;
  int parts = 1;
  for (; pass >= parts * parts; ++parts) pass -= parts * parts;
  const double length = exposure.length() / parts, begin = exposure.begin + length * (pass % parts);
  return {begin, begin + length};
}

}  // namespace tempera
