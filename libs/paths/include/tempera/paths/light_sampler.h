// SPDX-License-Identifier: Apache-2.0
#pragma once
// Choosing lights and points on them for next-event estimation, and the density with which that would have happened for
// a light that a ray found: at any time of a RayScene's span.
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "tempera/accel/ray_scene.h"

namespace tempera {

/// A direction towards light from a reference point.
struct LightSample {
  Vec3f wi;            ///< unit, from the reference point to the light
  float distance = 0;  ///< infinity for directional lights and environments
  Rgb radiance;   ///< arriving along wi if nothing is in between; for delta lights already divided as needed: value /
                  ///< pdf is the estimate
  float pdf = 0;  ///< solid angle density at the reference point including the choice of the light; delta lights:
                  ///< probability of the choice
  bool delta = false;                 ///< no ray finds this light by chance
  std::optional<SurfacePoint> point;  ///< for area lights
  std::uint32_t light = 0;            ///< which one, for LightSampler::connect
};

/// Threads: const and re-entrant.
class LightSampler {
 public:
  /// `scene` and `rays` must outlive this.
  LightSampler(const Scene& scene, const RayScene& rays);
  ~LightSampler();
  LightSampler(LightSampler&&) noexcept;

  bool empty() const;
  /// u_choice in [0,1), u in [0,1)^2. Black if the light does not shine towards p; empty if there is no direction to
  /// it.
  std::optional<LightSample> sample(const Vec3f& p, double t, float u_choice, const Vec2f& u) const;
  /// The same end of a path (the point of an area light, the direction of an environment, the lamp) seen from another
  /// place: where it is, what it sends there, and with which density sample() at `p` would have picked it.
  std::optional<LightSample> connect(const LightSample& sample, const Vec3f& p, double t) const;
  /// Radiance of the surface at `s` towards s.wo; black if it does not emit to that side.
  Rgb emitted(const SurfacePoint& point, const ShadingPoint& s) const;
  /// Density (solid angle at `from`) with which sample() picks the emitting surface point seen along a ray of length
  /// `distance`.
  float pdf(const SurfacePoint& point, const ShadingPoint& s, const Vec3f& from, float distance) const;
  /// Radiance of all environments along world direction d, for rays that leave the scene.
  Rgb environment(const Vec3f& d, double t, bool from_camera = false) const;
  /// Density with which sample() picks direction d from the environments at point `from`.
  float environment_pdf(const Vec3f& d, double t, const Vec3f& from) const;
  bool has_environment() const;
  /// Where the part of the environment that is seen in direction d at `from` stands at time `to`: the first environment
  /// that turns decides; fixed ones leave d as it is.
  Vec3f environment_motion(const Vec3f& d, double from, double to) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace tempera
