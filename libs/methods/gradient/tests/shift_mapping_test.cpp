// SPDX-License-Identifier: Apache-2.0
#include "../shift_mapping.h"

#include <gtest/gtest.h>

#include <functional>

#include "tempera/core/random.h"

namespace tempera {
namespace {

float uniform(std::uint64_t key, std::uint64_t i) { return to_unit_float(std::uint32_t(hash_key(key, i) >> 32)); }

Vec3f direction(std::uint64_t key, std::uint64_t i, bool upper) {
  const float z = 0.15f + 0.8f * uniform(key, 2 * i), phi = 2 * kPi * uniform(key, 2 * i + 1), s = std::sqrt(1 - z * z);
  return {s * std::cos(phi), s * std::sin(phi), upper ? z : -z};
}

/// Change of solid angle by finite differences of the map of unit directions.
double numerical_jacobian(const Vec3f& wi, const std::function<std::optional<Vec3f>(const Vec3f&)>& map) {
  const Basis b(wi);
  const float h = 1e-3f;
  const auto at = [&](float s, float t) { return map(normalize(wi + b.s * s + b.t * t)); };
  const auto s0 = at(-h, 0), s1 = at(h, 0), t0 = at(0, -h), t1 = at(0, h);
  if (!s0 || !s1 || !t0 || !t1) return -1;
  const Vec3d ds = Vec3d(*s1) - Vec3d(*s0), dt = Vec3d(*t1) - Vec3d(*t0);
  return length(cross(ds, dt)) / (4.0 * h * h);
}

// Jacobians against finite differences, and the way back, for random configurations.
TEST(ShiftMapping, JacobiansAndInverses) {
  int reflections = 0, refractions = 0, passages = 0;
  for (std::uint64_t i = 0; i < 2000; ++i) {
    const Vec3f wo = direction(1, i, true), wo_offset = direction(2, i, true);
    const float eta = 0.6f + uniform(3, i), eta_offset = 0.6f + uniform(4, i);
    struct Kind {
      const char* name;
      std::function<std::optional<ShiftedDirection>(const Vec3f& wo, const Vec3f& wi, const Vec3f& wo_offset,
                                                    bool back)>
          shift;
      bool transmits;
      int& count;
    };
    const Kind kinds[] = {
        {"reflection", [](const Vec3f& a, const Vec3f& w, const Vec3f& c, bool) { return shift_reflection(a, w, c); },
         false, reflections},
        {"passage", [](const Vec3f& a, const Vec3f& w, const Vec3f& c, bool) { return shift_passage(a, w, c); }, true,
         passages},
        {"refraction",
         [&](const Vec3f& a, const Vec3f& w, const Vec3f& c, bool back) {
           return back ? shift_refraction(a, w, eta_offset, c, eta) : shift_refraction(a, w, eta, c, eta_offset);
         },
         true, refractions},
    };
    for (const Kind& k : kinds) {
      const Vec3f wi = direction(5, i, !k.transmits);
      const auto there = k.shift(wo, wi, wo_offset, false);
      if (!there || std::abs(there->wi.z) < 0.1f) continue;
      const double expected = numerical_jacobian(wi, [&](const Vec3f& w) -> std::optional<Vec3f> {
        const auto s = k.shift(wo, w, wo_offset, false);
        return s ? std::optional(s->wi) : std::nullopt;
      });
      if (expected < 0 || there->jacobian > 30) continue;  // at the edge of its domain
      EXPECT_NEAR(there->jacobian / expected, 1, 0.01) << k.name;
      const auto back = k.shift(wo_offset, there->wi, wo, true);
      ASSERT_TRUE(back) << k.name;
      EXPECT_LT(length(back->wi - wi), 1e-4f) << k.name;
      EXPECT_NEAR(back->jacobian * there->jacobian, 1, 1e-3) << k.name;
      ++k.count;
    }
    // Reconnection: the solid angle of one patch of surface from two places.
    const Vec3f y{0, 0, 0}, x = direction(6, i, true) * (0.5f + uniform(7, i)),
                            x_offset = direction(8, i, true) * (0.5f + uniform(9, i));
    const auto patch = [&](const Vec3f& from) {
      const float h = 1e-3f;
      const auto d = [&](float u, float v) { return Vec3d(normalize(Vec3f{u, v, 0} - from)); };
      return length(cross(d(h, 0) - d(-h, 0), d(0, h) - d(0, -h)));
    };
    EXPECT_NEAR(reconnection_jacobian(x, x_offset, y, {0, 0, 1}) / (patch(x_offset) / patch(x)), 1, 2e-3);
  }
  EXPECT_GT(reflections, 500);
  EXPECT_GT(passages, 500);
  EXPECT_GT(refractions, 150);
}

}  // namespace
}  // namespace tempera
