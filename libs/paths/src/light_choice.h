// SPDX-License-Identifier: Apache-2.0
#pragma once
// Which light to sample from a point: by the irradiance that each would give there unshadowed, as far as that can be
// told from its position and extent alone.
#include <array>
#include <span>
#include <vector>

#include "distribution.h"
#include "tempera/core/vec.h"

namespace tempera {

/// What a light gives at a distance: `constant` everywhere, plus `near` / distance^2 to `center`, at least `radius`
/// away.
struct LightReach {
  float constant = 0;  ///< irradiance, W/m^2
  float near = 0;      ///< W
  Vec3f center;
  float radius = 0;
  float irradiance(const Vec3f& p) const {
    if (near == 0) return constant;
    return constant + near / std::max(length_squared(p - center), radius * radius);
  }
};

/// Threads: const and re-entrant.
class LightChoice {
 public:
  LightChoice() = default;
  /// `powers` chooses among many lights, where asking each one at every point would cost too much.
  LightChoice(std::vector<LightReach> lights, std::span<const float> powers)
      : lights_(std::move(lights)), by_power_(powers) {}

  bool empty() const { return lights_.empty(); }

  struct Pick {
    std::uint32_t light = 0;
    float probability = 0;
  };
  /// Probability 0 if no light is on. `u` in [0,1); afterwards the position within the light's share, again in [0,1).
  Pick sample(const Vec3f& p, float& u) const {
    if (lights_.size() == 1) return {0, lights_[0].irradiance(p) > 0 ? 1.0f : 0.0f};
    if (lights_.size() > kMaxAsked) {
      const std::uint32_t i = by_power_.sample(u);
      return {i, by_power_.probability(i)};
    }
    std::array<float, kMaxAsked> weights;
    const float sum = weigh(p, weights);
    if (!(sum > 0)) return {};
    float rest = u * sum;
    std::uint32_t i = 0;
    while (i + 1 < lights_.size() && rest >= weights[i]) rest -= weights[i++];
    while (weights[i] == 0) --i;  // rounding ran past the last light that is on
    u = std::clamp(rest / weights[i], 0.0f, 0x1.fffffep-1f);
    return {i, weights[i] / sum};
  }
  float probability(const Vec3f& p, std::uint32_t light) const {
    if (lights_.size() == 1) return lights_[0].irradiance(p) > 0 ? 1.0f : 0.0f;
    if (lights_.size() > kMaxAsked) return by_power_.probability(light);
    std::array<float, kMaxAsked> weights;
    const float sum = weigh(p, weights);
    return sum > 0 ? weights[light] / sum : 0.0f;
  }

 private:
  static constexpr std::size_t kMaxAsked = 32;
  /// A tenth goes evenly to all lights that are on: what looks weak may be all that is not in shadow.
  float weigh(const Vec3f& p, std::array<float, kMaxAsked>& weights) const {
    float sum = 0;
    int on = 0;
    for (std::size_t i = 0; i < lights_.size(); ++i) {
      weights[i] = lights_[i].irradiance(p);
      sum += weights[i];
      on += weights[i] > 0;
    }
    if (on == 0) return 0;
    const float even = 0.1f * sum / float(on);
    float total = 0;
    for (std::size_t i = 0; i < lights_.size(); ++i) {
      if (weights[i] > 0) weights[i] = 0.9f * weights[i] + even;
      total += weights[i];
    }
    return total;
  }
  std::vector<LightReach> lights_;
  Discrete by_power_;
};

}  // namespace tempera
