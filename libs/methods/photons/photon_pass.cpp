// SPDX-License-Identifier: Apache-2.0
#include "photons/photon_pass.h"

#include <fmt/format.h>

#include <algorithm>

#include "tempera/core/log.h"

namespace tempera {

namespace {
constexpr std::int64_t kPhotonsOfUnit = 4096;
constexpr int kMostRows = 10000;
const std::string kPhotonsKey = "tempera/photons";
constexpr std::uint64_t kMostMaps = std::uint64_t(1) << 20;  // instants of all pieces of an exposure

/// Errors: Error{kUnknownName} for a name that no light of the scene has.
void check_names(const std::vector<std::string>& names, const Scene& scene) {
  std::vector<std::string> known;
  for (const Instance& instance : scene.instances) {
    const std::vector<int>& shapes = scene.groups[instance.group];
    if (std::any_of(shapes.begin(), shapes.end(), [&](int i) { return scene.shapes[i].emission.has_value(); }))
      known.push_back(instance.name);
  }
  for (const PunctualLight& light : scene.lights) known.push_back(light.name);
  for (const Environment& environment : scene.environments) known.push_back(environment.name);
  for (const std::string& name : names) {
    if (std::find(known.begin(), known.end(), name) != known.end()) continue;
    throw Error(ErrorCode::kUnknownName, {},
                fmt::format("photon_lights: no light is called \"{}\"; known: {}", name, nearest_names(name, known)));
  }
}

}  // namespace

void PhotonState::save(ByteWriter& out) const {
  out.value(row_);
  if (light_) {
    out.value(std::uint64_t(piece_of_.size()));
    for (std::size_t i = 0, of_piece = 0; i < piece_of_.size(); ++i) {
      of_piece = i > 0 && piece_of_[i] == piece_of_[i - 1] ? of_piece + 1 : 0;
      out.values(light_->maps(piece_of_[i])[of_piece]->photons());
    }
    return;
  }
  out.value(std::uint64_t(photons_.size()));
  for (const auto& p : photons_) out.values(p);
}

void PhotonState::load(ByteReader& in) {
  in.value(row_);
  if (row_ < 0 || row_ > kMostRows) throw Error(ErrorCode::kBadInput, "photons of a pass that cannot be");
  const auto count = in.value<std::uint64_t>();
  if (count > kMostMaps) throw Error(ErrorCode::kBadInput, "photons of too many instants");
  photons_.resize(count);
  for (auto& p : photons_) in.values(p);
}

std::int64_t PhotonPass::units(const RenderSettings& settings) const {
  return (options_.photons_for(settings) + kPhotonsOfUnit - 1) / kPhotonsOfUnit;
}

std::vector<PassDesc> PhotonPass::passes(const RenderSettings& settings, const std::vector<PassDesc>& gather) const {
  const std::int64_t n = options_.photons_for(settings);
  const double pixels = double(settings.x1() - settings.x0()) * double(settings.y1() - settings.y0());
  std::vector<PassDesc> result;
  for (int row = 0; row < options_.passes; ++row) {
    const auto name = [&](const std::string& one) {
      return options_.passes == 1 ? one : fmt::format("{}, {} of {}", one, row + 1, options_.passes);
    };
    result.push_back({.name = name("photons"),
                      .domain = PassDesc::Domain::kPaths,
                      .waits = row > 0,
                      .units = units(settings),
                      .memory = std::uint64_t(3 * double(n) * sizeof(Photon) / pixels)});
    for (std::size_t i = 0; i < gather.size(); ++i) {
      result.push_back(gather[i]);
      result.back().name = name(gather[i].name);
      result.back().waits |= i == 0;
    }
  }
  return result;
}

void PhotonPass::begin(const SceneWindow& window, PhotonState& state, int row) const {
  if (row != state.row_) state = PhotonState();
  state.row_ = row;
  make_tracers(window, state);
}

void PhotonPass::make_tracers(const SceneWindow& window, PhotonState& state) const {
  if (!state.tracers_.empty()) return;
  check_names(options_.lights, window.scene());
  const FrameContext& frame = window.frame(window.section().first);
  bool casters = false;
  // Footprints that are taken at each sample's time stand for all of it.
  const bool whole = needs_instants(frame, window.settings().clock.exposure(frame.frame));
  const std::vector<ExposurePiece> pieces = exposure_pieces_of(frame);
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    const auto sets = int(options_.instants_of(pieces[i].span, state.row_, whole).size());
    for (int set = 0; set < sets; ++set) {
      state.tracers_.emplace_back(*pieces[i].context, options_, pieces[i].span, set,
                                  options_.photons_for(window.settings()) / sets, max_depth_, state.row_, whole);
      state.piece_of_.push_back(i);
      casters |= state.tracers_.back().has_casters();
    }
  }
  if (!casters) {
    std::call_once(warned_, [] { log_warning(kNoCasters); });
  }
}

void PhotonPass::run(const SceneWindow& window, const PhotonState& state, std::int64_t unit, UnitOutput& out,
                     RenderCounters& counters, const std::stop_token& stop) const {
  Bytes kept;
  ByteWriter writer(kept);
  std::uint64_t rays = 0;
  for (const PhotonTracer& tracer : state.tracers_) {
    std::vector<Photon> photons;
    PhotonCounts counts;
    const std::int64_t n = tracer.photons(), of = units(window.settings());
    for (std::int64_t i = n * unit / of; i < n * (unit + 1) / of; ++i) {
      if (stop.stop_requested()) return;
      tracer.trace(i, photons, counts, rays);
    }
    writer.value(counts);
    writer.values(photons);
  }
  counters.rays += rays;
  out.keep(std::move(kept));
}

void PhotonPass::end(const SceneWindow& window, PhotonState& state, const PassResult& result) const {
  make_tracers(window, state);
  state.photons_.assign(state.tracers_.size(), {});
  PhotonCounts counts;
  for (const auto& kept : result.kept) {
    if (!kept) continue;
    ByteReader reader(*kept);
    for (auto& photons : state.photons_) {
      counts += reader.value<PhotonCounts>();
      std::vector<Photon> part;
      reader.values(part);
      photons.insert(photons.end(), part.begin(), part.end());
    }
  }
  const std::string summary = describe(counts);
  for (Frame* picture : result.pictures) picture->metadata[kPhotonsKey] = summary;
  log(LogLevel::kInfo, fmt::format("frame {}: {}", window.section().first, summary));
}

void PhotonPass::begin_gather(const SceneWindow& window, PhotonState& state) const {
  if (state.light_) return;
  make_tracers(window, state);
  const FrameContext& frame = window.frame(window.section().first);
  state.light_ = std::make_unique<PhotonLight>(frame, 1u << window.settings().classes.size());
  const std::vector<ExposurePiece> pieces = exposure_pieces_of(frame);
  state.photons_.resize(state.tracers_.size());
  const bool instants = needs_instants(frame, window.settings().clock.exposure(frame.frame));
  for (std::size_t i = 0; i < state.tracers_.size(); ++i) {
    const FrameContext& context = *pieces[state.piece_of_[i]].context;
    state.light_->add(state.piece_of_[i], PhotonMap(state.tracers_[i], std::move(state.photons_[i]), context.classifier,
                                                    context.rays, instants));
  }
  state.photons_.clear();
  log(LogLevel::kDebug,
      fmt::format("frame {}: photons take {:.1f} MiB", frame.frame, double(state.light_->memory()) / (1 << 20)));
}

std::vector<std::string> photon_classes(const std::optional<PhotonPass>& photons) {
  return photons ? std::vector<std::string>{kPhotonPaths} : std::vector<std::string>{};
}

std::vector<ParamSpec> caustics_params(bool progressive) {
  std::vector<ParamSpec> s{{"caustics",
                            std::string("paths"),
                            "who finds light that mirrors and glass focus on diffuse surfaces",
                            -1e300,
                            1e300,
                            {"paths", "photons"}}};
  for (const ParamSpec& p : PhotonOptions::params()) {
    if (p.name != "progressive" || progressive) s.push_back(p);
  }
  return s;
}

bool caustics_by_photons(const Params& p) { return p.get_string("caustics") == "photons"; }

}  // namespace tempera
