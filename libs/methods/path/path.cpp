// SPDX-License-Identifier: Apache-2.0
// Path tracing with next-event estimation and multiple importance sampling; caustics by it too, or by photons whose
// footprints move [Schjoth 2010].
#include "photons/photon_pass.h"
#include "tempera/methods/method.h"
#include "tempera/methods/motion_layers.h"
#include "tempera/transport/path_tracer.h"
#include "tempera/transport/tile_film.h"

namespace tempera {

namespace {

/// Who finds caustics, and how photons move.
enum class Caustics : std::uint8_t { kPaths, kPhotons, kStillPhotons, kDiscs };

const std::vector<ParamSpec>& path_params() {
  static const std::vector<ParamSpec> specs = [] {
    std::vector<ParamSpec> s = PathOptions::params();
    s.push_back({"clamp", 0.0,
                 "largest luminance that one sample may add through scattered light; 0: off (clamping is biased)", 0,
                 1e9});
    s.push_back({"feature_samples", 0,
                 "further samples of a pixel for feature layers alone (albedo, normal, chains, ...): cheap, and what "
                 "denoisers gain most from",
                 0, 4096});
    s.push_back({"adaptive_error", 0.0,
                 "stop sampling a pixel at this relative error of its mean; 0: off, every pixel gets spp", 0, 1});
    s.push_back({"adaptive_min_spp", 32, "samples that every pixel gets under adaptive sampling", 4, 1e6});
    return s;
  }();
  return specs;
}

std::vector<ParamSpec> path_params_and(const std::vector<ParamSpec>& more) {
  std::vector<ParamSpec> s = path_params();
  s.insert(s.end(), more.begin(), more.end());
  return s;
}

class PathMethod final : public Method {
 public:
  PathMethod(const Params& p, Caustics caustics)
      : options_(p),
        feature_samples_(p.get_int("feature_samples")),
        adaptive_error_(float(p.get_double("adaptive_error"))),
        adaptive_min_spp_(p.get_int("adaptive_min_spp")) {
    options_.clamp = float(p.get_double("clamp"));
    if (caustics == Caustics::kPaths) return;
    PhotonOptions photons(p);
    if (caustics != Caustics::kDiscs) photons.temporal = caustics == Caustics::kPhotons;
    photons_.emplace(photons, options_.max_depth);
    rows_ = photons_->progressive();
  }

  std::vector<LayerDesc> outputs(const RenderSettings& settings) const override {
    const std::vector<std::string> more{"photon.color", "photon.color.a", "photon.color.b"};
    if (rows_ > 1 && adaptive_error_ > 0) {
      throw SettingError(ErrorCode::kUnsupported, "integrator.progressive",
                         "passes of photons divide the samples evenly: progressive goes with adaptive_error = 0 alone");
    }
    return film_outputs(settings, "path", photons_ ? more : std::vector<std::string>{});
  }

  std::vector<std::string> own_classes() const override { return photon_classes(photons_); }

  std::vector<PassDesc> passes(const RenderSettings& settings, FrameRange /*section*/) const override {
    if (!photons_) return {{.name = "samples"}};
    std::vector<PassDesc> result = photons_->passes(settings, {{.name = "samples"}});
    for (std::size_t i = 1; i + 2 < result.size(); i += 2) result[i].memory = TileFilm::bytes_of_pixel(settings);
    return result;
  }
  std::unique_ptr<SectionState> begin(const SceneWindow& /*window*/) const override {
    return photons_ ? std::make_unique<PhotonState>() : nullptr;
  }
  bool renders_single_pixels() const override { return adaptive_error_ == 0; }
  void begin_pass(const SceneWindow& window, SectionState* state, int pass,
                  std::span<const Image> /*reads*/) const override {
    if (traces_photons(pass)) return photons_->begin(window, photon_state(state), pass / 2);
    if (photons_) photons_->begin_gather(window, photon_state(state));
    prepare_motion_layers(window);
  }
  void end_pass(const SceneWindow& window, SectionState* state, int pass, const PassResult& result) const override {
    if (traces_photons(pass)) photons_->end(window, photon_state(state), result);
  }

  void run(const SceneWindow& window, SectionState* state, const Unit& unit, UnitOutput& out, RenderCounters& counters,
           std::stop_token stop) const override {
    if (traces_photons(unit.pass)) {
      photons_->run(window, photon_state(state), unit.number, out, counters, stop);
      return;
    }
    const GatheredLight* gathered = photons_ ? photon_state(state).light() : nullptr;
    const FrameContext& context = window.frame(unit.frame);
    const Tile& tile = unit.tile;
    TileFilm film(context, tile, out.picture());
    const int row = unit.pass / 2, spp = context.settings.spp;
    if (row > 0) {
      ByteReader in(out.kept());
      film.load(in);
    }
    std::uint64_t samples = 0, rays = 0, shadow_rays = 0;
    const auto take = [&](int x, int y, int index) {
      const CameraSample camera = camera_sample(context, x, y, index);
      NoObserver none;
      const SampleResult r = trace_path(context.at(camera.time), options_, camera, film.sample_classes(),
                                        film.features(), none, film.chains(), gathered);
      ++samples;
      rays += r.rays;
      shadow_rays += r.shadow_rays;
      if (!film.add(x, y, index, camera, r)) counters.note_bad({context.frame, x, y, index, own_key(context, x, y)});
    };
    const auto first = int(std::int64_t(spp) * row / rows_), end = int(std::int64_t(spp) * (row + 1) / rows_);
    if (adaptive_error_ > 0 ? !sample_adaptively(tile, spp, film, take, stop)
                            : !sample_evenly(tile, first, end, out, take, stop)) {
      return;
    }
    const bool last = row + 1 == rows_;
    if (last && !sample_features(context, tile, out, film, rays, stop)) return;
    film.write(out.picture());
    if (last) {
      write_motion_layers(window, unit, out);
    } else {
      Bytes bytes;
      ByteWriter writer(bytes);
      film.save(writer);
      out.keep(std::move(bytes));
    }
    counters.samples += samples;
    counters.rays += rays;
    counters.shadow_rays += shadow_rays;
  }

  Rgb replay(const FrameContext& context, const BadSample& sample) const override {
    const CameraSample camera = camera_sample(context, sample.numbers, sample.x, sample.y, sample.sample);
    NoObserver none;
    return trace_path(context.at(camera.time), options_, camera, {}, Features::kNone, none).radiance * camera.weight;
  }

 private:
  bool traces_photons(int pass) const { return photons_ && pass % 2 == 0; }
  static PhotonState& photon_state(SectionState* state) { return *static_cast<PhotonState*>(state); }

  /// Returns false if it was stopped.
  bool sample_features(const FrameContext& context, const Tile& tile, const UnitOutput& out, TileFilm& film,
                       std::uint64_t& rays, const std::stop_token& stop) const {
    if (film.features() == Features::kNone && !film.chains()) return true;
    for (int y = tile.y0; y < tile.y1 && feature_samples_ > 0; ++y) {
      for (int x = tile.x0; x < tile.x1; ++x) {
        if (stop.stop_requested()) return false;
        if (!out.wants(x, y)) continue;
        for (int i = 0; i < feature_samples_; ++i) {
          const CameraSample camera = camera_sample(context, x, y, context.settings.spp + i);
          const SampleResult r =
              trace_features(context.at(camera.time), options_, camera, film.features(), film.chains());
          rays += r.rays;
          film.add_features(x, y, camera, r.first);
        }
      }
    }
    return true;
  }
  /// Both return false if they were stopped.
  template <class Take>
  static bool sample_evenly(const Tile& tile, int first, int end, const UnitOutput& out, Take&& take,
                            const std::stop_token& stop) {
    for (int y = tile.y0; y < tile.y1; ++y) {
      for (int x = tile.x0; x < tile.x1; ++x) {
        if (stop.stop_requested()) return false;
        if (!out.wants(x, y)) continue;
        for (int i = first; i < end; ++i) take(x, y, i);
      }
    }
    return true;
  }
  /// Passes over the tile, each doubling the samples where a pixel or a neighbour is still too noisy. Only pixels of
  /// the tile are looked at, so that the result does not depend on what else was rendered.
  template <class Take>
  bool sample_adaptively(const Tile& tile, int spp, const TileFilm& film, Take&& take,
                         const std::stop_token& stop) const {
    const int w = tile.x1 - tile.x0, h = tile.y1 - tile.y0;
    std::vector<char> active(std::size_t(w) * std::size_t(h), 1);
    const auto at = [&](int x, int y) { return std::size_t(y - tile.y0) * std::size_t(w) + std::size_t(x - tile.x0); };
    for (int done = 0; done < spp;) {
      const int until = std::min(spp, done == 0 ? adaptive_min_spp_ : 2 * done);
      for (int y = tile.y0; y < tile.y1; ++y) {
        for (int x = tile.x0; x < tile.x1; ++x) {
          if (stop.stop_requested()) return false;
          if (!active[at(x, y)]) continue;
          for (int i = done; i < until; ++i) take(x, y, i);
        }
      }
      done = until;
      std::vector<char> next(active.size(), 0);
      for (int y = tile.y0; y < tile.y1; ++y) {
        for (int x = tile.x0; x < tile.x1; ++x) {
          if (!active[at(x, y)] || film.relative_error(x, y) <= adaptive_error_) continue;
          for (int j = std::max(tile.y0, y - 1); j <= std::min(tile.y1 - 1, y + 1); ++j) {
            for (int k = std::max(tile.x0, x - 1); k <= std::min(tile.x1 - 1, x + 1); ++k) next[at(k, j)] = 1;
          }
        }
      }
      for (std::size_t i = 0; i < active.size(); ++i) active[i] = active[i] && next[i];
    }
    return true;
  }

  PathOptions options_;
  std::optional<PhotonPass> photons_;
  int rows_ = 1;  ///< of passes, which divide the samples
  int feature_samples_;
  float adaptive_error_;
  int adaptive_min_spp_;
};

template <Caustics caustics>
std::unique_ptr<Method> make(const Params& p) {
  return std::make_unique<PathMethod>(p, caustics);
}

const std::vector<ParamSpec>& photon_params() {
  static const std::vector<ParamSpec> specs = path_params_and(PhotonOptions::params());
  return specs;
}
const std::vector<ParamSpec>& params() {
  static const std::vector<ParamSpec> specs = path_params_and(caustics_params(true));
  return specs;
}
template <bool over_time>
const std::vector<ParamSpec>& disc_params() {
  static const std::vector<ParamSpec> specs = path_params_and(PhotonOptions::disc_params(over_time));
  return specs;
}

}  // namespace

extern const MethodEntry path_entry;
const MethodEntry path_entry{"path", "Path tracing with next-event estimation and multiple importance sampling",
                             params(), [](const Params& p) -> std::unique_ptr<Method> {
                               return std::make_unique<PathMethod>(
                                   p, caustics_by_photons(p) ? Caustics::kPhotons : Caustics::kPaths);
                             }};

extern const MethodEntry temporal_photon_entry;
const MethodEntry temporal_photon_entry{
    "temporal_photon", "Path tracing with caustics by temporal photon differentials: photons whose footprints move",
    photon_params(), make<Caustics::kPhotons>};

extern const MethodEntry photon_differentials_entry;
const MethodEntry photon_differentials_entry{
    "photon_differentials", "The same with photons that stand still in the middle of the exposure, to compare with",
    photon_params(), make<Caustics::kStillPhotons>};

extern const MethodEntry photon_entry;
const MethodEntry photon_entry{"photon",
                               "Path tracing with caustics by a plain photon map, to compare with [Jensen 2001]",
                               disc_params<false>(), make<Caustics::kDiscs>};

extern const MethodEntry time_photon_entry;
const MethodEntry time_photon_entry{
    "time_photon", "The same with photons of several instants of the exposure, to compare with [Cammarano 2002]",
    disc_params<true>(), make<Caustics::kDiscs>};

}  // namespace tempera
