// SPDX-License-Identifier: Apache-2.0
#include "photons/photon_pass.h"

#include <fmt/format.h>

#include <algorithm>

#include "tempera/core/log.h"

namespace tempera {

namespace {
constexpr std::int64_t kPhotonsOfUnit = 4096;
}

void PhotonState::save(ByteWriter& out) const {
  out.value(std::uint64_t(photons_.size()));
  for (const auto& p : photons_) out.values(p);
}

void PhotonState::load(ByteReader& in) {
  photons_.resize(std::min(in.value<std::uint64_t>(), std::uint64_t(1) << 20));
  for (auto& p : photons_) in.values(p);
}

std::int64_t PhotonPass::photons(const RenderSettings& s) const {
  if (options_.photons > 0) return options_.photons;
  // About a tenth of the time of the samples of the whole picture.
  const double samples = double(s.width) * double(s.height) * double(s.spp);
  return std::int64_t(std::clamp(samples / 16, 20000.0, 2e6));
}

PassDesc PhotonPass::desc(const RenderSettings& settings) const {
  const std::int64_t n = photons(settings);
  const double pixels = double(settings.x1() - settings.x0()) * double(settings.y1() - settings.y0());
  return {.name = "photons",
          .domain = PassDesc::Domain::kPaths,
          .units = (n + kPhotonsOfUnit - 1) / kPhotonsOfUnit,
          .memory = std::uint64_t(3 * double(n) * sizeof(Photon) / pixels)};
}

void PhotonPass::begin(const SceneWindow& window, PhotonState& state) const {
  if (!state.tracers_.empty()) return;
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

void PhotonPass::run(const SceneWindow& /*window*/, const PhotonState& state, std::int64_t unit, UnitOutput& out,
                     RenderCounters& counters, const std::stop_token& stop) const {
  Bytes kept;
  ByteWriter writer(kept);
  std::uint64_t rays = 0;
  for (const PhotonTracer& tracer : state.tracers_) {
    std::vector<Photon> photons;
    PhotonCounts counts;
    const std::int64_t first = unit * kPhotonsOfUnit, last = std::min(first + kPhotonsOfUnit, tracer.photons());
    for (std::int64_t i = first; i < last; ++i) {
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
