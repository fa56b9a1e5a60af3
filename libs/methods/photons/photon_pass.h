// SPDX-License-Identifier: Apache-2.0
#pragma once
// The pass in which a frame's photons are traced, for methods that leave caustics to them.
#include <mutex>
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
  std::vector<PhotonTracer> tracers_;         // of all instants of all pieces of the exposure
  std::vector<std::size_t> piece_of_;         // by tracer
  std::vector<std::vector<Photon>> photons_;  // by tracer, in the order of their numbers
  std::unique_ptr<PhotonLight> light_;
};

/// Threads: as Method.
class PhotonPass {
 public:
  PhotonPass(const PhotonOptions& options, int max_depth) : options_(options), max_depth_(max_depth) {}

  /// To stand before the first pass that gathers, which has to wait for it.
  PassDesc desc(const RenderSettings& settings) const;

  /// Errors: Error{kUnknownName} for the name of a light that the scene lacks.
  void begin(const SceneWindow& window, PhotonState& state) const;
  void run(const SceneWindow& window, const PhotonState& state, std::int64_t unit, UnitOutput& out,
           RenderCounters& counters, const std::stop_token& stop) const;
  void end(const SceneWindow& window, PhotonState& state, const PassResult& result) const;
  /// Makes the maps of what end() or a checkpoint left. `class_bit`: of kPhotonPaths in the frame's classifier.
  void begin_gather(const SceneWindow& window, PhotonState& state, int class_bit) const;

 private:
  /// Photons that are emitted for a frame, about; in so many units.
  std::int64_t photons(const RenderSettings& settings) const;
  std::int64_t units(const RenderSettings& settings) const;

  PhotonOptions options_;
  int max_depth_;
  mutable std::once_flag warned_;
};

}  // namespace tempera
