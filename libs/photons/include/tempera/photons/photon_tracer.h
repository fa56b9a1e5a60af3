// SPDX-License-Identifier: Apache-2.0
#pragma once
// Photons for caustics: light that mirrors and glass send onto surfaces that scatter it diffusely, traced from the
// lights with its derivatives. [Schjoth 2010, Sec. 3]
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "tempera/paths/light_aim.h"
#include "tempera/photons/beam.h"
#include "tempera/photons/photon.h"
#include "tempera/photons/photon_options.h"
#include "tempera/transport/path_tracer.h"

namespace tempera {

/// Paths that photons stand for: they end, seen from the eye, with D and specular events up to the light, at least one
/// of which is not the passage through a thin sheet.
inline constexpr const char* kPhotonPaths = "E.*DP*[^DVP][RT]*";

/// What became of the photons of a frame.
struct PhotonCounts {
  std::int64_t emitted = 0, stored = 0, clamped = 0, curved = 0;
  double emitted_flux = 0, stored_flux = 0, escaped_flux = 0, absorbed_flux = 0;  ///< W, luminance
  PhotonCounts& operator+=(const PhotonCounts& o);
};
/// "20000 photons emitted, 14200 stored; ...": for people.
std::string describe(const PhotonCounts& counts);

/// What to say where find_casters finds none.
inline constexpr const char* kNoCasters =
    "photons: no surface of the scene reflects or refracts light sharply, so there are no caustics to find";

/// Boxes around all that may send light on by R or T and not straight through, at any time of `span`: each is that of a
/// shape or of several near each other, at most LightAim::kMaxTargets. Materials are asked at some points of a shape.
std::vector<Bounds3f> find_casters(const RayScene& rays, TimeSpan span);

/// Photons of one piece of an exposure, all traced at one instant. Threads: const and re-entrant.
class PhotonTracer {
 public:
  /// `exposure`: of the piece, `piece`: its context, which must outlive this. `set`: which of the instants of the exposure
  /// (PhotonOptions::instants_of); each has photons of its own, and so has each `pass` of PhotonOptions::passes.
  /// `whole`: whether photons of each pass stand for the whole exposure. `photons`: about as many are emitted.
  PhotonTracer(const FrameContext& piece, const PhotonOptions& options, TimeSpan exposure, int set,
               std::int64_t photons, int max_depth, int pass = 0, bool whole = false);

  bool has_casters() const { return !casters_.empty(); }
  double instant() const { return instant_; }
  TimeSpan exposure() const { return exposure_; }
  /// When the shutter is open since the instant, and how footprints are spread.
  const KernelSettings& kernel() const { return kernel_; }
  /// Of discs, m; 0: footprints are ellipses.
  double disc_radius() const;
  /// As PhotonOptions::nearest.
  int nearest() const { return options_.nearest; }
  /// How many there are: those asked for, but for rounding, and at least two for each part of the light of each lamp.
  std::int64_t photons() const { return photons_; }
  /// By instance: whether any of it moves within the exposure.
  const std::vector<char>& moves() const { return moves_; }
  /// Whether they are two independent sets, as layers of halves and of variance ask for; one is spread more evenly.
  bool halves() const { return halves_; }
  /// Which lights emit them, by the indices of LightSample::light.
  std::span<const char> lights() const { return lights_; }

  /// Traces photon `index` of photons() and appends what is stored of it.
  void trace(std::int64_t index, std::vector<Photon>& out, PhotonCounts& counts, std::uint64_t& rays) const;

 private:
  /// A light's photons of one part, numbered from `first`.
  struct Share {
    std::uint32_t light = 0;
    int part = 0;
    std::int64_t first = 0, count = 0;
  };
  struct Lamp {
    std::optional<LightAim> aim;
    std::vector<double> shares;
    std::int64_t photons = 0;
  };
  struct Branch;
  void plan();
  SampleStream stream_of(const Share& share, std::int64_t i) const;
  std::optional<Branch> start(const Share& share, std::int64_t i, PhotonCounts& counts) const;
  void trace(const Branch& first, const SampleStream& stream, int level, std::vector<Photon>& out, PhotonCounts& counts,
             std::uint64_t& rays) const;
  bool thin_out(float number, Branch& b) const;
  bool arrive(const SampleStream& stream, Branch& b, Vertex& v, SurfaceFrame& f, PhotonCounts& counts,
              std::uint64_t& rays) const;
  void store(const Branch& b, const SurfaceFrame& f, const SurfacePoint& point, std::vector<Photon>& out,
             PhotonCounts& counts) const;
  double least_radius(const Vec3d& p) const;
  bool meets_caster(const AimedLight& e) const;
  double overlap_of(std::int64_t photons) const;

  const FrameContext& context_;
  PhotonOptions options_;
  TimeSpan exposure_;
  int set_;       ///< counted through all passes
  double scale_;  ///< of the footprints' area
  double instant_;
  KernelSettings kernel_;
  std::int64_t photons_;
  int max_depth_;
  bool halves_;
  std::vector<Bounds3f> casters_;
  std::vector<Lamp> lamps_;
  std::vector<char> lights_;
  std::vector<Share> shares_;
  std::vector<char> moves_;
  double diameter_ = 0;
  double met_ = 1;  ///< part of what is aimed at casters that meets one
  Vec3d eye_;
  double pixel_size_ = 0, pixel_angle_ = 0;
};

}  // namespace tempera
