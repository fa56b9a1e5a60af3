// SPDX-License-Identifier: Apache-2.0
#include "tempera/scene/analytic.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tempera/core/random.h"

namespace tempera::analytic {
namespace {

double uniform(std::uint64_t key, std::uint64_t i) { return to_unit_float(std::uint32_t(hash_key(key, i) >> 32)); }

constexpr AnalyticKind kKinds[]{AnalyticKind::kSphere, AnalyticKind::kDisk, AnalyticKind::kCylinder};

TEST(Analytic, AreaIsTheIntegralOfItsParameters) {
  for (const AnalyticKind kind : kKinds) {
    constexpr int kSide = 400;
    double area = 0, moment = 0, sampled = 0;
    for (int i = 0; i < kSide; ++i) {
      for (int k = 0; k < kSide; ++k) {
        const double u = (i + 0.5) / kSide, v = (k + 0.5) / kSide;
        const UnitPoint<double> p = evaluate(kind, u, v);
        const double element = length(cross(p.dpdu, p.dpdv)) / (kSide * kSide);
        area += element;
        moment += element * (sqr(p.p.x) + 3 * sqr(p.p.z));
        EXPECT_NEAR(std::abs(dot(normalize(cross(p.dpdu, p.dpdv)), p.n)), 1, 1e-12);
        // Samples that are even in their numbers are even over the area.
        const Vec2f at = sample(kind, Vec2f(Vec2d{u, v}));
        const UnitPoint<float> q = evaluate(kind, at.x, at.y);
        sampled += (sqr(q.p.x) + 3 * sqr(q.p.z)) / double(kSide * kSide);
      }
    }
    EXPECT_NEAR(area, unit_area(kind), 1e-4);
    EXPECT_NEAR(sampled * area, moment, 1e-3);
  }
}

TEST(Analytic, CrossingsLieOnTheShape) {
  int hits = 0;
  for (std::uint64_t i = 0; i < 6000; ++i) {
    const AnalyticKind kind = kKinds[i % 3];
    const double angle = 2 * kPiD * uniform(i, 0);
    const Vec3d o{2.5 * std::cos(angle), 2.5 * std::sin(angle), 3 * uniform(i, 1) - 1};
    const Vec3d to{uniform(i, 2) - 0.5, uniform(i, 3) - 0.5, uniform(i, 4)};
    const Vec3d d = to - o;
    const auto hit = intersect(kind, o, d, 0, kInfinity);
    const auto line = cross_line(kind, o, d, hit ? hit->t : 0);
    if (!hit) continue;
    ++hits;
    ASSERT_TRUE(line);
    EXPECT_EQ(line->t, hit->t);
    EXPECT_LT(length(evaluate(kind, line->u, line->v).p - (o + d * line->t)), 1e-14);
    EXPECT_NEAR(line->u, hit->u, 1e-6);
    EXPECT_NEAR(line->v, hit->v, 1e-6);
    if (kind == AnalyticKind::kSphere) {
      const Vec2f uv = sphere_uv(Vec3f(o + d * line->t));
      EXPECT_NEAR(uv.x, hit->u, 1e-5);
      EXPECT_NEAR(uv.y, hit->v, 1e-3);
    }
  }
  EXPECT_GT(hits, 4000);
  // At a pole, where the arc cosine is of no use.
  const auto pole = cross_line(AnalyticKind::kSphere, {1e-9, 0, 3}, {0, 0, -1}, 2);
  ASSERT_TRUE(pole);
  EXPECT_NEAR(pole->v * kPiD, 1e-9, 1e-15);
}

TEST(Analytic, BoundsAreTight) {
  const Affine3d map{{1, 0.3, -0.2}, {0.1, 0.8, 0.5}, {-0.4, 0.2, 2}, {3, 1, -2}};
  for (const AnalyticKind kind : kKinds) {
    const Bounds3f box = bounds(kind, map);
    Bounds3f seen;
    for (int i = 0; i <= 500; ++i) {
      for (int k = 0; k <= 500; ++k) seen.extend(Vec3f(map.point(evaluate(kind, i / 500.0, k / 500.0).p)));
    }
    EXPECT_LT(length(box.lo - seen.lo) + length(box.hi - seen.hi), 1e-3f);
  }
}

}  // namespace
}  // namespace tempera::analytic
