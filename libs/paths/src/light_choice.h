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
/// away. `radius` is above 0 unless `near` is 0.
struct LightReach {
  float constant = 0;  ///< irradiance, W/m^2
  float near = 0;      ///< W
  Vec3f center;
  float radius = 0;
};

/// Threads: const and re-entrant.
class LightChoice {
 public:
  LightChoice() = default;
  /// `powers` chooses among many lights, where asking each one at every point would cost too much.
  LightChoice(std::span<const LightReach> lights, std::span<const float> powers)
      : count_(lights.size()), by_power_(powers) {
    if (count_ == 1) lone_probability_ = lights[0].constant > 0 || lights[0].near > 0 ? 1.0f : 0.0f;
    if (count_ > kMaxAsked) return;
    eights_.resize((count_ + 7) / 8);
    for (std::size_t i = 0; i < count_; ++i) {
      Eight& e = eights_[i / 8];
      const LightReach& l = lights[i];
      e.constant[i % 8] = l.constant, e.near[i % 8] = l.near;
      e.x[i % 8] = l.center.x, e.y[i % 8] = l.center.y, e.z[i % 8] = l.center.z;
      if (l.near != 0) e.radius2[i % 8] = l.radius * l.radius;
    }
  }

  bool empty() const { return count_ == 0; }
  /// Among all lights, wherever they shine.
  const Discrete& by_power() const { return by_power_; }

  struct Pick {
    std::uint32_t light = 0;
    float probability = 0;
  };
  /// Probability 0 if no light is on. `u` in [0,1); afterwards the position within the light's share, again in [0,1).
  Pick sample(const Vec3f& p, float& u) const {
    if (count_ == 1) return {0, lone_probability_};
    if (count_ > kMaxAsked) {
      const std::uint32_t i = by_power_.sample(u);
      return {i, by_power_.probability(i)};
    }
    Weights weights;
    const float sum = weigh(p, weights);
    if (!(sum > 0)) return {};
    float rest = u * sum;
    std::uint32_t i = 0;
    while (i + 1 < count_ && rest >= weights[i]) rest -= weights[i++];
    while (weights[i] == 0) --i;  // rounding ran past the last light that is on
    u = std::clamp(rest / weights[i], 0.0f, 0x1.fffffep-1f);
    return {i, weights[i] / sum};
  }
  float probability(const Vec3f& p, std::uint32_t light) const {
    if (count_ == 1) return lone_probability_;
    if (count_ > kMaxAsked) return by_power_.probability(light);
    Weights weights;
    const float sum = weigh(p, weights);
    return sum > 0 ? weights[light] / sum : 0.0f;
  }

 private:
  static constexpr std::size_t kMaxAsked = 32;
  using Floats = float __attribute__((vector_size(32)));
  /// Eight lights at a time; what is left over is dark.
  struct Eight {
    Floats constant{}, near{}, x{}, y{}, z{}, radius2 = Floats{} + 1.0f;
  };
  struct Weights {
    std::array<Floats, kMaxAsked / 8> eights;
    float operator[](std::size_t i) const { return eights[i / 8][i % 8]; }
  };

  static float sum_of(const Floats& v) { return ((v[0] + v[4]) + (v[1] + v[5])) + ((v[2] + v[6]) + (v[3] + v[7])); }

  /// Returns the sum. A tenth goes evenly to all lights that are on: what looks weak may be all that is not in shadow.
  float weigh(const Vec3f& p, Weights& weights) const {
    Floats sums{}, on{};
    for (std::size_t k = 0; k < eights_.size(); ++k) {
      const Eight& e = eights_[k];
      const Floats dx = e.x - p.x, dy = e.y - p.y, dz = e.z - p.z, d2 = dx * dx + dy * dy + dz * dz;
      const Floats irradiance = e.constant + e.near / (d2 > e.radius2 ? d2 : e.radius2);
      weights.eights[k] = irradiance;
      sums += irradiance;
      on += irradiance > 0 ? Floats{} + 1.0f : Floats{};
    }
    const float sum = sum_of(sums);
    if (!(sum > 0)) return 0;
    const float even = 0.1f * sum / sum_of(on);
    for (std::size_t k = 0; k < eights_.size(); ++k) {
      Floats& w = weights.eights[k];
      w = w > 0 ? 0.9f * w + even : w;
    }
    return sum;
  }

  std::size_t count_ = 0;
  float lone_probability_ = 0;  // of the only light
  std::vector<Eight> eights_;
  Discrete by_power_;
};

}  // namespace tempera
