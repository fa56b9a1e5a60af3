// SPDX-License-Identifier: Apache-2.0
#include "tempera/gallery/polygons.h"

#include <gtest/gtest.h>

#include <map>

#include "tempera/core/error.h"
#include "tempera/gallery/implicit.h"

namespace tempera::gallery {
namespace {

/// Signed volume of a closed mesh: positive if the outside is outside.
double volume(const Polygons& p) {
  double sum = 0;
  for (std::size_t i = 0; i < p.indices.size(); i += 3) {
    const Vec3d a(p.positions[p.indices[i]]), b(p.positions[p.indices[i + 1]]), c(p.positions[p.indices[i + 2]]);
    sum += dot(a, cross(b, c)) / 6;
  }
  return sum;
}

/// Every edge, by positions, belongs to two triangles that run along it in opposite directions.
testing::AssertionResult IsClosed(const Polygons& p) {
  const auto key = [&](std::uint32_t v) {
    const Vec3f q = p.positions[v];
    return std::array{std::lround(q.x * 1e6), std::lround(q.y * 1e6), std::lround(q.z * 1e6)};
  };
  std::map<std::pair<std::array<long, 3>, std::array<long, 3>>, int> edges;
  for (std::size_t i = 0; i < p.indices.size(); i += 3) {
    for (std::size_t c = 0; c < 3; ++c) {
      const auto a = key(p.indices[i + c]), b = key(p.indices[i + (c + 1) % 3]);
      if (a == b) return testing::AssertionFailure() << "triangle " << i / 3 << " has an edge of no length";
      a < b ? ++edges[{a, b}] : --edges[{b, a}];
    }
  }
  for (const auto& [edge, balance] : edges) {
    if (balance != 0)
      return testing::AssertionFailure() << "open edge at " << double(edge.first[0]) * 1e-6 << ", "
                                         << double(edge.first[1]) * 1e-6 << ", " << double(edge.first[2]) * 1e-6;
  }
  return testing::AssertionSuccess();
}

/// Unit normals that lie on the outer side of their triangles.
testing::AssertionResult NormalsAgree(const Polygons& p, double least = 0.3) {
  if (p.normals.size() != p.positions.size() || p.uvs.size() != p.positions.size())
    return testing::AssertionFailure() << "attributes of different lengths";
  for (const Vec3f& n : p.normals) {
    if (std::abs(length(n) - 1) > 1e-4f) return testing::AssertionFailure() << "a normal of length " << length(n);
  }
  for (std::size_t i = 0; i < p.indices.size(); i += 3) {
    const Vec3d a(p.positions[p.indices[i]]), b(p.positions[p.indices[i + 1]]), c(p.positions[p.indices[i + 2]]);
    const Vec3d n = normalize(cross(b - a, c - a));
    for (std::size_t k = 0; k < 3; ++k) {
      const double agreement = dot(n, Vec3d(p.normals[p.indices[i + k]]));
      if (!(agreement >= least))
        return testing::AssertionFailure() << "triangle " << i / 3 << " and its normal: cosine " << agreement;
    }
  }
  return testing::AssertionSuccess();
}

void check_solid(const Polygons& p, double expected, double tolerance) {
  EXPECT_TRUE(IsClosed(p));
  EXPECT_TRUE(NormalsAgree(p));
  EXPECT_NEAR(volume(p) / expected, 1, tolerance);
}

TEST(Polygons, SolidsAreClosedAndHaveTheirVolume) {
  check_solid(sphere(0.5, 96, 48), 4.0 / 3 * kPiD * 0.125, 4e-3);
  check_solid(cylinder(0.3, -0.5, 1.5, 96), kPiD * 0.09 * 2, 2e-3);
  check_solid(cylinder(0.3, 0, 1, 96, 0.05), kPiD * 0.09, 2e-2);
  check_solid(box({1, 2, 3}), 6, 1e-6);
  check_solid(rounded_box({1, 2, 3}, 0.001, 2), 6, 5e-3);
  // A box whose corners are those of a ball: Steiner's formula for an inner box of 0.6 x 0.4 x 0.2 and radius 0.2.
  const double faces = 2 * (0.6 * 0.4 + 0.4 * 0.2 + 0.2 * 0.6), edges = kPiD * (0.6 + 0.4 + 0.2);
  check_solid(rounded_box({1.0, 0.8, 0.6}, 0.2, 12), 0.048 + faces * 0.2 + edges * 0.04 + 4.0 / 3 * kPiD * 0.008, 2e-3);
  const std::vector<Vec3d> straight{{0, 0, 0}, {0, 0, 1}, {0, 0, 2}};
  check_solid(tube(straight, std::vector<double>{0.1}, 64, false), kPiD * 0.01 * 2, 3e-3);
  check_solid(capsule({0, 0, 0}, {1, 1, 0}, 0.2, 0.2, 64), kPiD * 0.04 * std::sqrt(2.0) + 4.0 / 3 * kPiD * 0.008, 1e-2);
  // A ring: Pappus.
  std::vector<Vec2d> circle;
  for (int k = 0; k <= 48; ++k) {
    const double a = 2 * kPiD * k / 48;
    circle.push_back({1 + 0.25 * std::cos(a), 0.25 * std::sin(a)});
  }
  circle.back() = circle.front();
  check_solid(lathe(circle, 96), 2 * kPiD * kPiD * 0.0625, 6e-3);
}

TEST(Polygons, ExtrudesOutlinesThatAreNotConvex) {
  const std::vector<Vec2d> corner{{0, 0}, {2, 0}, {2, 1}, {1, 1}, {1, 3}, {0, 3}};
  check_solid(extrude(corner, 0.5), 4 * 0.5, 1e-6);
  const std::vector<Vec2d> crossed{{0, 0}, {2, 2}, {2, 0}, {0, 2}};
  EXPECT_THROW(extrude(crossed, 1), Error);
}

TEST(Polygons, EdgesAreSharpBeyondTheCrease) {
  const std::vector<Vec2d> can{{0, 0}, {1, 0}, {1, 2}, {0, 2}};
  for (const Vec3f& n : lathe(can, 24).normals) EXPECT_TRUE(std::abs(n.y) < 1e-6f || std::abs(n.y) > 1 - 1e-6f) << n.y;
  const Polygons ball = sphere(2, 32, 16);
  for (std::size_t i = 0; i < ball.positions.size(); ++i)
    EXPECT_GT(dot(ball.normals[i], normalize(ball.positions[i])), 1 - 1e-5f);
}

TEST(Polygons, PlanesFaceWhereTheySay) {
  for (const Vec3f& n : floor_plane({2, 3}, {1, 1}, 3, 2).normals) EXPECT_EQ(n, (Vec3f{0, 1, 0}));
  EXPECT_TRUE(NormalsAgree(floor_plane({2, 3}, {1, 1}, 3, 2)));
  for (const Vec3f& n : wall_plane({2, 3}).normals) EXPECT_EQ(n, (Vec3f{0, 0, 1}));
  EXPECT_TRUE(NormalsAgree(wall_plane({2, 3})));
  const Polygons hill = sheet(8, 8, [](double u, double v) { return Vec3d{u, 0.3 * u * v, -v}; });
  EXPECT_TRUE(NormalsAgree(hill, 0.95));
  EXPECT_GT(hill.normals[0].y, 0);
}

TEST(Polygons, MovedPartsKeepTheirOutside) {
  Polygons two;
  two.add(box({1, 1, 1}), turned({1, 2, 3}, 40, {5, 0, 0})).add(box({1, 1, 1}), scale(Vec3d{-1, 2, 1}));
  EXPECT_TRUE(NormalsAgree(two, 0.999));
  EXPECT_NEAR(volume(two), 3, 1e-5);
  EXPECT_EQ(two.triangle_count(), 24u);
}

TEST(Polygons, AlongTakesYToTheDirection) {
  const Affine3d m = along({1, 2, 3}, {1, 2, 8});
  EXPECT_NEAR(length(m.point({0, 5, 0}) - Vec3d{1, 2, 8}), 0, 1e-12);
  EXPECT_NEAR(m.determinant(), 1, 1e-12);
}

TEST(Polygons, CurvesPassThroughTheirPoints) {
  const std::vector<Vec3d> points{{0, 0, 0}, {1, 2, 0}, {2, 1, 1}, {4, 0, 0}};
  const std::vector<Vec3d> line = curve(points, 5);
  ASSERT_EQ(line.size(), 16u);
  for (std::size_t i = 0; i < points.size(); ++i) EXPECT_NEAR(length(line[5 * i] - points[i]), 0, 1e-12);
}

TEST(Implicit, PolygonizedSolidsAreClosedAndOnTheSurface) {
  const auto two_balls = [](const Vec3d& p) {
    return blend(ball(p, {-0.25, 0, 0}, 0.4), ball(p, {0.25, 0, 0}, 0.4), 0);
  };
  const Polygons apart = polygonize(
      [](const Vec3d& p) {
        return ball(p, {0.1, 0.2, 0.3}, 0.5);
      },
      {-0.5, -0.4, -0.3}, {0.7, 0.8, 0.9}, 0.04);
  check_solid(apart, 4.0 / 3 * kPiD * 0.125, 5e-3);
  for (const Vec3f& p : apart.positions) EXPECT_NEAR(length(Vec3d(p) - Vec3d{0.1, 0.2, 0.3}), 0.5, 1e-5);
  const Polygons joined = polygonize(two_balls, {-0.7, -0.5, -0.5}, {0.7, 0.5, 0.5}, 0.04);
  EXPECT_TRUE(IsClosed(joined));
  // Two balls without the lens that they share.
  const double cap = 0.15, lens = 2 * kPiD * cap * cap * (0.4 - cap / 3);
  EXPECT_NEAR(volume(joined), 2 * 4.0 / 3 * kPiD * 0.064 - lens, 3e-3);
}

TEST(Implicit, DistancesHaveTheirSigns) {
  const std::vector<Vec2d> cone{{0, 0}, {1, 0}, {0, 2}};
  EXPECT_LT(turned_solid({0.2, 0.5, 0.2}, cone), 0);
  EXPECT_GT(turned_solid({0.9, 1.0, 0}, cone), 0);
  EXPECT_NEAR(turned_solid({0.3, -0.5, 0.4}, cone), 0.5, 1e-12);
  EXPECT_NEAR(limb({0, 3, 0}, {0, 0, 0}, {0, 2, 0}, 0.5, 0.25), 0.75, 1e-12);
  EXPECT_LT(blend(0.1, 0.1, 0.2), 0.1);
  EXPECT_EQ(blend(0.1, 0.5, 0.2), 0.1);
  EXPECT_GT(carve(-1, -0.5, 0), 0);
}

}  // namespace
}  // namespace tempera::gallery
