// SPDX-License-Identifier: Apache-2.0
#pragma once
// Photons of a frame, found by the point that their footprints cover. [Schjoth 2010, Eq. 8]
#include <array>
#include <memory>
#include <vector>

#include "tempera/accel/box_index.h"
#include "tempera/photons/photon_tracer.h"
#include "tempera/photons/point_index.h"
#include "tempera/transport/path_tracer.h"

namespace tempera {

/// Photons of one piece of an exposure: two halves of independent photons. Threads: const and re-entrant.
class PhotonMap {
 public:
  /// `photons`: all that `tracer` gave, in the order of their numbers. `always_instant`: footprints are taken where they
  /// are at the time of a sample; else those on still receivers stand for the whole exposure.
  PhotonMap(const PhotonTracer& tracer, std::vector<Photon> photons, const LightPathClassifier& classifier,
            const RayScene& rays, bool always_instant);

  /// What arrives at a vertex at time t by paths of at most `most_edges` from photons of half 0 or 1; from all if
  /// `half` is -1, or there are no halves. Photons from nearly the same direction arrive as one. `coarse`: from an eighth of them with
  /// footprints of twice the area.
  void gather(const Vertex& at, double t, int half, bool coarse, int most_edges,
              std::vector<GatheredLight::Arrival>& out) const;

  /// The same from the photons on the disc around the vertex that holds those nearest to it.
  void gather_disc(const Vertex& at, int half, int most_edges, float radius_squared,
                   std::vector<GatheredLight::Arrival>& out) const;
  /// Adds how far photons that gather may take are from a vertex.
  void find_nearest(const Vertex& at, int half, int most_edges, NearestDistance& found) const;
  /// How many of the nearest photons light is estimated from; 0: from all whose footprints cover a point.
  int nearest() const { return nearest_; }
  float largest_radius() const { return radius_; }

  /// Those that it was made of, in another order: a map made of these has the same bits.
  const std::vector<Photon>& photons() const { return sets_[0].photons; }
  /// Which lights emit photons, by the indices of LightSample::light.
  std::span<const char> lights() const { return lights_; }
  /// Bytes that it holds.
  std::uint64_t memory() const;

 private:
  /// Photons, ordered by half, then by place.
  struct Set {
    std::vector<Photon> photons;
    std::array<std::uint32_t, 2> first_of_half{};
    std::vector<BoxIndex> index;     // by half
    std::vector<PointIndex> points;  // in place of it, where the nearest photons are looked for
  };
  Set make_set(std::vector<Photon> photons) const;
  struct Place;
  Place place_of(const Vertex& at) const;
  bool counts(const Photon& p, const Place& at, int most_edges) const;
  std::array<Set, 2> sets_;                                    // fine, coarse
  std::vector<std::vector<LightPathClassifier::State>> ends_;  // by suffix
  KernelSettings kernel_;
  int nearest_;
  float radius_;
  double instant_;
  bool always_instant_, halves_;
  std::vector<char> moves_;
  std::vector<char> lights_;
  const RayScene& rays_;
};

/// The maps of all pieces of a frame's exposure, as the light that a path tracer lacks.
class PhotonLight final : public GatheredLight {
 public:
  /// `classes`: the bit of kPhotonPaths in the frame's classifier.
  PhotonLight(const FrameContext& frame, std::uint32_t classes) : frame_(frame), classes_(classes) {}
  /// Adds a map of piece `piece` of the exposure, the last one or the next. Several of one piece count in their mean.
  void add(std::size_t piece, PhotonMap map);
  /// Those that were added, by piece.
  std::span<const std::unique_ptr<PhotonMap>> maps(std::size_t piece) const { return maps_[piece]; }
  std::uint64_t memory() const;

  std::uint32_t classes() const override { return classes_; }
  std::span<const char> lights(double time) const override { return lights_[frame_.piece_at(time)]; }
  std::span<const Arrival> arriving(const Vertex& at, double time, int sample, bool coarse,
                                    int most_edges) const override;

 private:
  const FrameContext& frame_;
  std::uint32_t classes_;
  std::vector<std::vector<std::unique_ptr<PhotonMap>>> maps_;  // by piece
  std::vector<std::vector<char>> lights_;                      // by piece
};

/// The pieces of a frame's exposure, each with its span: one if nothing jumps.
struct ExposurePiece {
  const FrameContext* context;
  TimeSpan span;
};
std::vector<ExposurePiece> exposure_pieces_of(const FrameContext& frame);
/// Whether footprints have to be taken at each sample's own time: where the camera moves during the exposure, or lines of
/// the picture are exposed one after the other, or the shutter opens gradually.
bool needs_instants(const FrameContext& frame, TimeSpan exposure);

}  // namespace tempera
