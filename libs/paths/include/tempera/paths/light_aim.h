// SPDX-License-Identifier: Apache-2.0
#pragma once
// Light that leaves one light towards parts of the scene: photons for caustics are sent to what casts them, which a
// light that shines everywhere would seldom meet.
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "tempera/paths/light_sampler.h"

namespace tempera {

/// A start of a light path, with the densities by which it was sent and how its light moves.
struct AimedLight {
  Vec3d p;  ///< where it starts: on the surface, at the lamp, or on a plane outside of the scene
  Vec3d w;  ///< unit, the direction in which light leaves
  Vec3f n;  ///< unit geometric normal of an area light; else zero
  /// Flux times the densities of position and direction: radiance times the cosine of area lights, radiance of suns and
  /// environments, intensity (W/sr) of lights without size, irradiance (W/m^2) of directional lights without an angle.
  Rgb power;
  /// Densities of all parts, each counted by its share: by area (1/m^2; of the light, or across w for lights at
  /// infinity) and by solid angle (1/sr); 1 for what a light has no choice of.
  double pdf_position = 1, pdf_direction = 1;
  bool delta_position = false, delta_direction = false, infinite = false;
  double pivot =
      0;  ///< distance from the start, m, at which light from infinity stays where it is if its direction turns
  /// Motion of the start and turn of the direction of light that leaves the light at the same place of it: m/s, rad/s.
  Vec3d velocity, turn;
};

/// One light and the boxes that it is aimed at, at one time. Threads: const and re-entrant.
class LightAim {
 public:
  /// `light`: 0 to light_count(lights) - 1. `targets`: not empty boxes; `t`: within the rays' span of `lights`, which
  /// must outlive this. At most kMaxTargets of them.
  LightAim(const LightSampler& lights, std::uint32_t light, std::span<const Bounds3f> targets, double t);

  static constexpr std::size_t kMaxTargets = 16;
  static std::uint32_t light_count(const LightSampler& lights);
  /// The name of the lamp, the emitting object or the environment, as in the scene.
  static std::string light_name(const LightSampler& lights, std::uint32_t light);

  /// Whether light comes from few directions: every lamp, and environments that have a quarter of their light from texels
  /// that are sixteen times as bright as the mean. Paths from the eye meet the others well through mirrors and glass.
  static bool is_concentrated(const LightSampler& lights, std::uint32_t light);

  /// Parts that light is sent by: part 0 goes wherever the light shines, part k towards target k - 1.
  int parts() const { return int(targets_.size()) + 1; }
  /// Light of a part; `shares`: which fraction of all that is sent goes by each part, together 1. `choice` in [0,1),
  /// `position` and `direction` in [0,1)^2, as LightSampler::emit takes them. Empty where the part has no way or no
  /// light: it counts as sent, though.
  std::optional<AimedLight> emit(int part, std::span<const double> shares, float choice, const Vec2f& position,
                                 const Vec2f& direction) const;

 private:
  const LightSampler& lights_;
  std::uint32_t light_;
  std::vector<Bounds3f> targets_;
  double t_;
};

}  // namespace tempera
