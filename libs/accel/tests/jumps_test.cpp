// SPDX-License-Identifier: Apache-2.0
// Motion that rays and matrices have trouble with: jumps, and places that are flat or nothing at all.
#include <gtest/gtest.h>

#include <cmath>

#include "../src/motion.h"
#include "tempera/accel/motion_error.h"
#include "tempera/accel/ray_scene.h"

namespace tempera {
namespace {

struct SceneBuilder {
  Scene scene;
  int node(const AnimatedTransform& local, int parent = -1) {
    scene.nodes.push_back({parent, local, "", 1.0f});
    return int(scene.nodes.size()) - 1;
  }
  void instance(int group, int node) { scene.instances.push_back({group, node, "", true}); }
  int group(Geometry g) {
    scene.shapes.push_back({std::move(g), make_black(), std::nullopt, "", ""});
    scene.groups.push_back({int(scene.shapes.size()) - 1});
    return int(scene.groups.size()) - 1;
  }
  void add(Geometry g, int node) { instance(group(std::move(g)), node); }
};

AnimatedTransform scaling(std::vector<double> times, std::vector<Vec3d> scales,
                          Interpolation interpolation = Interpolation::kLinear) {
  AnimatedTransform t;
  t.keyed = true;
  t.scale = {std::move(times), std::move(scales), interpolation};
  return t;
}
AnimatedTransform moving(std::vector<double> times, std::vector<Vec3d> places, Interpolation interpolation) {
  AnimatedTransform t;
  t.keyed = true;
  t.translation = {std::move(times), std::move(places), interpolation};
  return t;
}

/// Part of the square [-2, 2]^2 through which parallel rays along `d` from `side` meet something, on a grid.
double covered(const RayScene& rays, const Vec3f& d, double t, int n = 64) {
  const Basis basis(d);
  int hits = 0, lost = 0;
  for (int i = 0; i < n * n; ++i) {
    const float x = 4 * (float(i % n) + 0.5f) / float(n) - 2, y = 4 * (float(i / n) + 0.5f) / float(n) - 2;
    const Ray ray{basis.s * x + basis.t * y - d * 10, d, 0, kInfinity, t};
    const auto hit = rays.intersect(ray);
    EXPECT_EQ(hit.has_value(), rays.occluded(ray));
    if (!hit) continue;
    ++hits;
    const ShadingPoint s = rays.shading_point(hit->point, t, -d);
    EXPECT_TRUE(is_finite(s.p) && is_finite(s.ng) && is_finite(s.frame.n) && is_finite(s.dpdu));
    EXPECT_NEAR(length(s.ng), 1, 1e-4);
    EXPECT_LT(length(s.p - (ray.o + ray.d * hit->t)), 1e-3f);
    const SurfaceFrame f = rays.surface(hit->point, hit->point.u, hit->point.v, t);
    EXPECT_TRUE(is_finite(f.dpdt) && is_finite(f.dndt) && is_finite(f.dngdt) && is_finite(f.dndu));
    EXPECT_LT(length(f.p - Vec3d(s.p)), 1e-5 * (1 + length(f.p)));
    if (const auto exact = rays.refine(*hit, Vec3d(ray.o), Vec3d(d), t)) {
      const Vec3d p = rays.surface(hit->point, exact->u, exact->v, t).p;
      EXPECT_LT(length(p - (Vec3d(ray.o) + Vec3d(d) * exact->distance)), 1e-12);
      EXPECT_LT(std::abs(exact->distance - double(hit->t)), 1e-3);
    } else {
      ++lost;
    }
  }
  EXPECT_LE(lost, hits / 20 + 1);  // at edges and along flat sides
  return 16.0 * hits / (n * n);
}

constexpr RaySceneOptions kQuarters{.motion_step = 0.25};

Geometry shape_of(int kind) {
  if (kind == 0) return make_cube();
  if (kind == 1) return Sphere{};
  if (kind == 2) return Disk{};
  return Cylinder{};
}

// Every kind of shape, still and moving, used once and shared, scaled to nothing in one, two or all directions.
TEST(SingularPlaces, AreFlatOrVanish) {
  const std::array<Vec3d, 8> scales{Vec3d{0, 0, 0}, Vec3d{1, 1, 0}, Vec3d{1, 0, 1},     Vec3d{0, 1, 1},
                                    Vec3d{1, 0, 0}, Vec3d{0, 0, 1}, Vec3d{1e-30, 1, 1}, Vec3d{1e-25, 1e-25, 1e-25}};
  // Silhouettes along z where the shape is flat in z.
  const std::array<double, 4> seen_from_z{4, kPiD, kPiD, 0};
  for (int kind = 0; kind < 4; ++kind) {
    for (const Vec3d& s : scales) {
      for (const bool moves : {false, true}) {
        for (const bool shared : {false, true}) {
          SceneBuilder b;
          AnimatedTransform place{Affine3d(scale(s))};
          if (moves) place = scaling({0, 1, 2}, {s, s, s});
          const int n = b.node(place), g = b.group(shape_of(kind));
          b.instance(g, n);
          if (shared) b.instance(g, b.node(Affine3d(translate(Vec3d{50, 0, 0}))));
          GeometryCache cache;
          const RayScene rays(b.scene, {0.1, 0.9}, {0, 1}, kQuarters, cache);
          for (const Vec3f& d : {Vec3f{0, 0, -1}, normalize(Vec3f{0.1f, -0.2f, 1}), normalize(Vec3f{1, 0.3f, 0.2f})}) {
            covered(rays, d, 0.3, 16);
          }
          SCOPED_TRACE(testing::Message() << kind << " " << s.x << "," << s.y << "," << s.z << " " << moves << shared);
          if (s == Vec3d{1, 1, 0}) {
            EXPECT_NEAR(covered(rays, {0, 0, -1}, 0.3), seen_from_z[kind], 0.05);
            if (kind != 3) {  // by the cosine, here 0.5
              const Vec3f d = normalize(Vec3f{0, std::sqrt(3.0f), -1});
              EXPECT_NEAR(covered(rays, d, 0.3), 0.5 * seen_from_z[kind], 0.1);
            }
          }
          const bool nothing = s == Vec3d{0, 0, 0};
          EXPECT_FALSE(nothing && covered(rays, {0, 0, -1}, 0.3) > 0);
        }
      }
    }
  }
}

TEST(SingularPlaces, ScaleThroughZeroIsNoTurn) {
  for (int kind = 0; kind < 2; ++kind) {
    SceneBuilder b;
    b.add(shape_of(kind), b.node(scaling({0, 1}, {{1, 1, 1}, {-1, 1, 1}})));
    GeometryCache cache;
    const RayScene rays(b.scene, {0, 1}, {0, 1}, kQuarters, cache);
    const double silhouette = kind == 0 ? 4 : kPiD;
    for (const double t : {0.0, 0.1, 0.37, 0.49, 0.5, 0.51, 0.6, 0.9, 1.0}) {
      EXPECT_NEAR(covered(rays, {1, 0, 0}, t), silhouette, 0.05) << t;
      const double wide = std::abs(1 - 2 * t);
      EXPECT_NEAR(covered(rays, {0, 0, 1}, t), silhouette * wide, 0.3) << t;
    }
  }
}

// The front stays in front, whether or not the map mirrors.
TEST(SingularPlaces, NormalsPointOutOnBothSidesOfTheFlip) {
  SceneBuilder b;
  b.add(make_cube(), b.node(scaling({0, 1}, {{1, 1, 1}, {-1, 1, 1}})));
  GeometryCache cache;
  const RayScene rays(b.scene, {0, 1}, {0, 1}, kQuarters, cache);
  for (const double t : {0.05, 0.3, 0.45, 0.55, 0.7, 0.95}) {
    for (const Vec3f& d : {Vec3f{1, 0, 0}, Vec3f{0, 1, 0}, Vec3f{0, 0, -1}}) {
      const auto hit = rays.intersect({d * -10 + Vec3f{0.01f, 0.02f, 0.03f}, d, 0, kInfinity, t});
      ASSERT_TRUE(hit) << t;
      EXPECT_LT(dot(rays.shading_point(hit->point, t, -d).ng, d), -0.9f) << t;
    }
  }
}

TEST(SingularPlaces, SkinsIgnoreTheNodeThatTheyHangOn) {
  SceneBuilder b;
  Mesh m = make_cube();
  m.skin.influences = 1;
  m.skin.joints = {{b.node(Affine3d{}), Affine3d{}}};
  m.skin.indices.assign(m.positions.size(), 0);
  m.skin.weights.assign(m.positions.size(), 1);
  b.add(m, b.node(Affine3d(scale(Vec3d{0, 0, 0}))));
  GeometryCache cache;
  const RayScene rays(b.scene, {0, 1}, {0, 1}, kQuarters, cache);
  EXPECT_NEAR(covered(rays, {0, 0, 1}, 0.5), 4, 0.05);
}

// Debian's Embree ends the program when a matrix, a bound or a ray is none.
TEST(SingularPlaces, NumbersThatAreNoneOrHugeDoNotEndTheProgram) {
  const double nan = std::numeric_limits<double>::quiet_NaN(), huge = 1e30;
  for (const double v : {nan, huge, -huge, double(kInfinity), 1e18, 1e12, 1e-12, 1e-18}) {
    for (const Affine3d& m : {Affine3d(scale(Vec3d{v, 1, 1})), Affine3d(scale(Vec3d{v, v, v})),
                              Affine3d(translate(Vec3d{v, 0, 0})), Affine3d{{1, v, 0}, {0, 1, 0}, {0, 0, 1}}}) {
      for (int kind = 0; kind < 4; ++kind) {
        for (const bool shared : {false, true}) {
          SceneBuilder b;
          const int g = b.group(shape_of(kind));
          b.instance(g, b.node(m));
          if (shared) b.instance(g, b.node(Affine3d(translate(Vec3d{0, 5, 0}))));
          b.add(Mesh{}, b.node(moving({0, 1}, {{0, 0, 0}, {1, 0, 0}}, Interpolation::kLinear)));
          GeometryCache cache;
          const RayScene rays(b.scene, {0, 1}, {0, 1}, kQuarters, cache);
          for (int i = 0; i < 64; ++i) {
            const float x = 0.1f * float(i % 8) - 0.4f, y = 0.1f * float(i / 8) - 0.4f;
            rays.intersect({{x, y, -10}, {0, 0, 1}, 0, kInfinity, 0.5});
            rays.occluded({{1e10f, y, -10}, {-1, x, 0.1f}, 0, kInfinity, 0.5});
          }
        }
      }
    }
  }
}

TEST(Decompose, RotationsStayRotationsAndFlipsStayFlips) {
  std::vector<Affine3d> turning, flipping, both;
  for (int k = 0; k <= 8; ++k) {
    turning.push_back(rotation(axis_angle(Vec3d{0, 0, 1}, 2.2 * k)));  // 126 degrees a knot
    flipping.push_back(rotation(axis_angle(Vec3d{0, 1, 0}, 0.1 * k)) * scale(Vec3d{1 - k / 3.7, 1, 2}));
    both.push_back(scale(Vec3d{1 - k / 3.7, 1 - k / 3.7, 1}));
  }
  for (const AffineKnot& k : decompose(turning)) EXPECT_LT(length(k.scale - Vec3f{1, 1, 1}), 1e-5f);
  const auto flips = decompose(flipping), two = decompose(both);
  for (int k = 0; k <= 8; ++k) {
    EXPECT_NEAR(flips[k].scale.x, 1 - k / 3.7, 1e-5) << k;
    EXPECT_NEAR(flips[k].scale.z, 2, 1e-5) << k;
    EXPECT_NEAR(two[k].scale.x, 1 - k / 3.7, 1e-5) << k;
    EXPECT_NEAR(std::abs(two[k].q.w), 1, 1e-5) << k;
  }
}

TEST(Jumps, NothingLiesBetweenTwoPoses) {
  for (const Interpolation how : {Interpolation::kStep, Interpolation::kLinear}) {
    SceneBuilder b;
    const AnimatedTransform jumping =
        how == Interpolation::kStep ? moving({0, 0.6}, {{-10, 0, 0}, {10, 0, 0}}, how)
                                    : moving({0, 0.6, 0.6, 1}, {{-10, 0, 0}, {-10, 0, 0}, {10, 0, 0}, {10, 0, 0}}, how);
    b.add(make_cube(), b.node(jumping));
    Mesh deforming = make_cube();
    deforming.morph_targets = {{std::vector<Vec3f>(deforming.positions.size(), Vec3f{0, 20, 0}), {}, {}}};
    deforming.morph_weights = {{0, 0.6}, {std::vector<float>{0}, {1}}, Interpolation::kStep};
    b.add(deforming, b.node(Affine3d(translate(Vec3d{40, 0, 0}))));
    const auto pieces = exposure_pieces(b.scene, {0.5, 1}, 0.25);
    ASSERT_EQ(pieces.size(), 2u);
    EXPECT_NEAR(pieces[0].end, 0.6, 1e-5);
    GeometryCache cache;
    for (std::size_t k = 0; k < 2; ++k) {
      const RayScene rays(b.scene, pieces[k], {0, 1.5}, kQuarters, cache);
      for (const double s : {0.01, 0.5, 0.99}) {
        const double t = pieces[k].begin + s * pieces[k].length();
        const auto sees = [&](float x, float y) { return rays.occluded({{x, y, -10}, {0, 0, 1}, 0, kInfinity, t}); };
        EXPECT_EQ(sees(-10, 0), k == 0) << t;
        EXPECT_EQ(sees(10, 0), k == 1) << t;
        EXPECT_EQ(sees(40, 0), k == 0) << t;
        EXPECT_EQ(sees(40, 20), k == 1) << t;
        for (float x = -8; x <= 8; x += 0.5f) EXPECT_FALSE(sees(x, 0)) << t << " " << x;
        for (float y = 2; y <= 18; y += 0.5f) EXPECT_FALSE(sees(40, y)) << t << " " << y;
      }
      // Points are where they are at other times.
      const SurfacePoint on_cube{0, 0, 0, 0.3f, 0.3f};
      EXPECT_LT(rays.position(on_cube, 0.3).x, -8);
      EXPECT_GT(rays.position(on_cube, 1.2).x, 8);
    }
  }
}

TEST(Jumps, WhatMovesUpToAJumpKeepsItsPaceUntilThen) {
  SceneBuilder b;
  b.add(make_cube(),
        b.node(moving({0, 0.6, 0.6, 1}, {{0, 0, 0}, {6, 0, 0}, {100, 0, 0}, {104, 0, 0}}, Interpolation::kLinear)));
  const auto pieces = exposure_pieces(b.scene, {0, 1}, 0.25);
  ASSERT_EQ(pieces.size(), 2u);
  GeometryCache cache;
  for (const TimeSpan piece : pieces) {
    const RayScene rays(b.scene, piece, {0, 1}, kQuarters, cache);
    for (const double s : {0.02, 0.5, 0.98}) {
      const double t = piece.begin + s * piece.length();
      const double x = t < 0.6 ? 10 * t : 100 + 10 * (t - 0.6);
      EXPECT_TRUE(rays.occluded({{float(x + 0.97), 0, -10}, {0, 0, 1}, 0, kInfinity, t})) << t;
      EXPECT_FALSE(rays.occluded({{float(x + 1.03), 0, -10}, {0, 0, 1}, 0, kInfinity, t})) << t;
    }
  }
}

TEST(Jumps, VisibilityChangesWithinAnExposure) {
  SceneBuilder b;
  const int n = b.node({});
  b.scene.nodes[0].visibility = {{0, 0.3, 0.8}, {0, 1, 0}, Interpolation::kStep};
  b.add(make_cube(), n);
  const auto pieces = exposure_pieces(b.scene, {0, 1}, 0.25);
  ASSERT_EQ(pieces.size(), 3u);
  GeometryCache cache;
  for (std::size_t k = 0; k < 3; ++k) {
    const RayScene rays(b.scene, pieces[k], {0, 1}, kQuarters, cache);
    const double t = 0.5 * (pieces[k].begin + pieces[k].end);
    EXPECT_EQ(rays.occluded({{0, 0, -10}, {0, 0, 1}, 0, kInfinity, t}), k == 1);
  }
}

TEST(Jumps, ExposuresAreCutToWhatARaySceneHolds) {
  SceneBuilder b;
  b.add(make_cube(), b.node(moving({0, 1}, {{0, 0, 0}, {1, 0, 0}}, Interpolation::kLinear)));
  const double step = 1.0 / 1000;
  const auto pieces = exposure_pieces(b.scene, {0.0003, 0.9997}, step);
  EXPECT_EQ(pieces.size(), 8u);
  double at = 0.0003;
  GeometryCache cache;
  for (const TimeSpan piece : pieces) {
    EXPECT_EQ(piece.begin, at);
    at = piece.end;
    EXPECT_NO_THROW(RayScene(b.scene, piece, piece, {.motion_step = step}, cache));
  }
  EXPECT_EQ(at, 0.9997);
}

// A rotor in a squashed parent: what is measured is what is misplaced.
TEST(MotionError, IsTheDistanceFromTheAuthoredMotion) {
  SceneBuilder b;
  AnimatedTransform rotor;
  rotor.keyed = true;
  std::vector<double> times;
  std::vector<Quatd> turns;
  for (int i = 0; i <= 64; ++i) {
    times.push_back(i / 64.0);
    turns.push_back(axis_angle(Vec3d{0, 0, 1}, kPiD * i / 64));
  }
  rotor.rotation = {times, turns, Interpolation::kLinear};
  const int squashed = b.node(Affine3d(scale(Vec3d{1, 0.3, 1})));
  b.add(make_rectangle(), b.node(rotor, squashed));
  const TimeSpan second{0, 1};
  const auto metres = [](const Vec3f& x, const Vec3f& y, double) { return double(length(x - y)); };
  double previous = 1;
  for (const double step : {0.5, 0.25, 0.125, 0.0625}) {
    const double error = motion_errors(b.scene, {&second, 1}, step, metres)[0];
    GeometryCache cache;
    const RayScene rays(b.scene, second, second, {.motion_step = step}, cache);
    double worst = 0;
    for (int i = 0; i <= 1000; ++i) {
      const double t = i / 1000.0;
      const Vec3f exact(b.scene.world(1, t).point({-1, -1, 0}));
      worst = std::max(worst, double(length(rays.position({0, 0, 0, 0, 0}, t) - exact)));
    }
    EXPECT_GT(error, 0.5 * worst);
    EXPECT_LT(error, 1.001 * worst + 1e-5);
    EXPECT_LT(error, previous);
    previous = error;
  }
  EXPECT_LT(previous, 0.05);
}

// Turns by whole revolutions between knots look like rest at the knots.
TEST(MotionError, WholeTurnsBetweenKnotsAreNotMissed) {
  SceneBuilder b;
  AnimatedTransform rotor;
  rotor.keyed = true;
  std::vector<double> times;
  std::vector<Quatd> turns;
  for (int i = 0; i <= 256; ++i) {
    times.push_back(i / 256.0);
    turns.push_back(axis_angle(Vec3d{0, 0, 1}, 16 * kPiD * i / 256));
  }
  rotor.rotation = {times, turns, Interpolation::kLinear};
  b.add(make_rectangle(), b.node(rotor));
  const TimeSpan second{0, 1};
  const auto metres = [](const Vec3f& x, const Vec3f& y, double) { return double(length(x - y)); };
  EXPECT_GT(motion_errors(b.scene, {&second, 1}, 0.25, metres)[0], 0.5);
  EXPECT_LT(motion_errors(b.scene, {&second, 1}, 1.0 / 64, metres)[0], 1e-3);
}

}  // namespace
}  // namespace tempera
