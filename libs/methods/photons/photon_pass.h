// SPDX-License-Identifier: Apache-2.0
#pragma once
// The pass in which a frame's photons are traced, for methods that leave caustics to them.
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "tempera/methods/method.h"
#include "tempera/photons/photon_map.h"

namespace tempera {

/// Photons of a frame: what the pass of photons leaves for passes that follow it.
class PhotonState final : public SectionState {
 public:
  void save(ByteWriter& out) const override;
  void load(ByteReader& in) override;
  /// What path tracing lacks; null before begin_gather.
  const PhotonLight* light() const { return light_.get(); }

 private:
  friend class PhotonPass;
  int row_ = 0;
  std::vector<PhotonTracer> tracers_;         // of all instants of all pieces of the exposure
  std::vector<std::size_t> piece_of_;         // by tracer
  std::vector<std::vector<Photon>> photons_;  // by tracer, in the order of their numbers
  std::unique_ptr<PhotonLight> light_;
};

/// Threads: as Method.
class PhotonPass {
 public:
  PhotonPass(const PhotonOptions& options, int max_depth) : options_(options), max_depth_(max_depth) {}

  /// The passes of a method, `gather` being those for one set of photons: in front of each such row the pass that traces
  /// them. There are progressive() rows, which divide the samples.
  std::vector<PassDesc> passes(const RenderSettings& settings, const std::vector<PassDesc>& gather) const;
  int progressive() const { return options_.passes; }

  /// Prepares the pass that traces the photons of a row.
  /// Errors: Error{kUnknownName} for the name of a light that the scene lacks.
  void begin(const SceneWindow& window, PhotonState& state, int row) const;
  void run(const SceneWindow& window, const PhotonState& state, std::int64_t unit, UnitOutput& out,
           RenderCounters& counters, const std::stop_token& stop) const;
  void end(const SceneWindow& window, PhotonState& state, const PassResult& result) const;
  /// Makes the maps of what end() or a checkpoint left.
  void begin_gather(const SceneWindow& window, PhotonState& state) const;

 private:
  void make_tracers(const SceneWindow& window, PhotonState& state) const;
  std::int64_t units(const RenderSettings& settings) const;

  PhotonOptions options_;
  int max_depth_;
  mutable std::once_flag warned_;
};

/// For Method::own_classes of methods that may leave caustics to photons.
std::vector<std::string> photon_classes(const std::optional<PhotonPass>& photons);
/// The parameters that choose and set photons: `caustics` and PhotonOptions::params(). `progressive`: whether there can be
/// several rows of passes.
std::vector<ParamSpec> caustics_params(bool progressive);
bool caustics_by_photons(const Params& p);

}  // namespace tempera
