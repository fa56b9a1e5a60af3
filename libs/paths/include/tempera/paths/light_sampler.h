// SPDX-License-Identifier: Apache-2.0
#pragma once
// Choosing lights and points on them for next-event estimation, and the density with which that would have happened for
// a light that a ray found; and light leaving its source, the start of a light subpath: at any time of a RayScene's
// span.
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
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

/// Where a light subpath starts: a point from which light leaves in one direction. Lights at infinity (environments,
/// directional lights) send it through a disk that is perpendicular to it and covers all that rays can hit. In path
/// expressions every such end is an L.
struct LightEnd {
  Vec3f p;  ///< of the surface (to be offset along n before a ray starts), the lamp, or the disk
  Vec3f w;  ///< unit, the direction in which light leaves
  Vec3f n;  ///< unit geometric normal of the surface; w for lights at infinity; zero for point lights, which have none
  /// By kind of light: radiance (area lights, environments, suns with an angle), W/(m^2 sr); radiant intensity (lights
  /// of no size), W/sr; irradiance across w (directional lights without an angle), W/m^2.
  Rgb radiance;
  /// The flux that the ray carries: radiance |dot(n, w)| / (pdf_choice pdf_position pdf_direction), where lights of no
  /// size have no cosine. Its mean over the samples of emit() is the power in W that all lights send into the scene.
  Rgb beta;
  float pdf_choice = 0;     ///< probability of the light; of all lights at infinity that shine along w, if it is one
  float pdf_position = 0;   ///< by area, 1/m^2; 1 if delta_position
  float pdf_direction = 0;  ///< by solid angle, 1/sr; 1 if delta_direction
  bool delta_position = false;        ///< the light has no size
  bool delta_direction = false;       ///< the light shines in one direction only
  bool infinite = false;              ///< the light is at infinity, and p stands for no place
  std::optional<SurfacePoint> point;  ///< of area lights
  std::uint32_t light = 0;            ///< which one, as in LightSample
};

/// The factors of the density with which LightSampler::emit picks an end: those of LightEnd.
struct EmissionPdf {
  float choice = 0, position = 0, direction = 0;
  float product() const { return choice * position * direction; }
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
  /// Light that leaves a source at time t, from anywhere in any direction. Lights are chosen half by the power that
  /// they give over the span, half evenly; points by area; directions by cosine within the spread of an area light, by
  /// solid angle within the cone of a spot, by the image of a projector or an environment. `choice` in [0,1),
  /// `position` and `direction` in [0,1)^2. Black if the light does not shine there at t. Empty if no light has power
  /// (then always), or if rounding picked what has density 0.
  std::optional<LightEnd> emit(double t, float choice, const Vec2f& position, const Vec2f& direction) const;
  /// Densities with which emit() picks the end (its light and point; where lights are at infinity the direction decides
  /// alone) and sends light in unit direction w from there. Densities of a delta are 1, its direction is not compared.
  EmissionPdf emission_pdf(const LightEnd& end, const Vec3f& w, double t) const;
  /// Radiance of the surface at `s` towards s.wo; black if it does not emit to that side.
  Rgb emitted(const SurfacePoint& point, const ShadingPoint& s) const;
  /// Density (solid angle at `from`) with which sample() picks the emitting surface point seen along a ray of length
  /// `distance`.
  float pdf(const SurfacePoint& point, const ShadingPoint& s, const Vec3f& from, float distance) const;
  /// Radiance of all environments along world direction d, for rays that leave the scene.
  Rgb environment(const Vec3f& d, double t, bool from_camera = false) const;
  /// Density with which sample() picks direction d from the environments at point `from`.
  float environment_pdf(const Vec3f& d, double t, const Vec3f& from) const;
  /// The same of those lights alone that are set in `lights`, by the indices of LightSample::light.
  Rgb environment(const Vec3f& d, double t, bool from_camera, std::span<const char> lights) const;
  /// Index, as in LightSample::light, of the area light that a point lies on. Pre: its shape emits.
  std::uint32_t light_of(const SurfacePoint& point) const;
  bool has_environment() const;
  /// Where the part of the environment that is seen in direction d at `from` stands at time `to`: the first environment
  /// that turns decides; fixed ones leave d as it is.
  Vec3f environment_motion(const Vec3f& d, double from, double to) const;

 private:
  friend class LightAim;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace tempera
