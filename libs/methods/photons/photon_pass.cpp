// SPDX-License-Identifier: Apache-2.0
#include "photons/photon_pass.h"

#include <fmt/format.h>

#include <algorithm>

#include "tempera/core/log.h"

namespace tempera {

namespace {
constexpr std::int64_t kPhotonsOfUnit = 4096;
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
  out.value(std::uint64_t(photons_.size()));
  for (const auto& p : photons_) out.values(p);
}

void PhotonState::load(ByteReader& in) {
  const auto count = in.value<std::uint64_t>();
  if (count > kMostMaps) throw Error(ErrorCode::kBadInput, "photons of too many instants");
  photons_.resize(count);
  for (auto& p : photons_) in.values(p);
}

std::int64_t PhotonPass::photons(const RenderSettings& s) const {
  if (options_.photons > 0) return options_.photons;
  // They take about as long as a quarter of the samples.
  const double samples = double(s.width) * double(s.height) * double(s.spp);
  return std::int64_t(std::clamp(samples / 16, 20000.0, 2e6));
}

std::int64_t PhotonPass::units(const RenderSettings& settings) const {
  return (photons(settings) + kPhotonsOfUnit - 1) / kPhotonsOfUnit;
}

PassDesc PhotonPass::desc(const RenderSettings& settings) const {
  const std::int64_t n = photons(settings);
  const double pixels = double(settings.x1() - settings.x0()) * double(settings.y1() - settings.y0());
  return {.name = "photons",
          .domain = PassDesc::Domain::kPaths,
          .units = units(settings),
          .memory = std::uint64_t(3 * double(n) * sizeof(Photon) / pixels)};
}

void PhotonPass::begin(const SceneWindow& window, PhotonState& state) const {
  if (!state.tracers_.empty()) return;
  check_names(options_.lights, window.scene());
  const FrameContext& frame = window.frame(window.section().first);
  bool casters = false;
  const std::vector<ExposurePiece> pieces = exposure_pieces_of(frame);
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    const auto sets = int(options_.instants_of(pieces[i].span).size());
    for (int set = 0; set < sets; ++set) {
      state.tracers_.emplace_back(*pieces[i].context, options_, pieces[i].span, set, photons(window.settings()) / sets,
                                  max_depth_);
      state.piece_of_.push_back(i);
      casters |= state.tracers_.back().has_casters();
    }
  }
  if (!casters) {
    std::call_once(warned_, [] {
      log_warning(
          "photons: no surface of the scene reflects or refracts light sharply, so there are no caustics to find");
    });
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
  begin(window, state);
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
  const double whole = std::max(counts.emitted_flux, 1e-300);
  log(LogLevel::kInfo,
      fmt::format(
          "frame {}: {} photons emitted, {} stored; of their flux {:.3g} % arrived, {:.3g} % escaped, {:.3g} % was "
          "absorbed; {} footprints limited, {} photons bent strongly",
          window.section().first, counts.emitted, counts.stored, 100 * counts.stored_flux / whole,
          100 * counts.escaped_flux / whole, 100 * counts.absorbed_flux / whole, counts.clamped, counts.curved));
}

void PhotonPass::begin_gather(const SceneWindow& window, PhotonState& state, int class_bit) const {
  if (state.light_) return;
  begin(window, state);
  const FrameContext& frame = window.frame(window.section().first);
  state.light_ = std::make_unique<PhotonLight>(frame, 1u << class_bit);
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

}  // namespace tempera
