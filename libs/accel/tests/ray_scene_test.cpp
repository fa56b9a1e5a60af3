// SPDX-License-Identifier: Apache-2.0
#include "tempera/accel/ray_scene.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "moving_scenes.h"
#include "tempera/accel/motion_error.h"

namespace tempera {
namespace {

// A point carried by the resampled motion lies where the ray at that time hit it: for every kind of motion.
TEST(RayScene, PointsAgreeWithRaysAtAnyTime) {
  const Scene scene = everything_moves();
  validate(scene);
  GeometryCache cache;
  const TimeSpan span{0.25, 0.75};
  const RayScene rays(scene, span, {0, 1}, {.motion_step = 1.0 / 16}, cache);
  std::vector<int> hits(scene.shapes.size());
  for (std::uint64_t i = 0; i < 60000; ++i) {
    const Ray ray = random_ray(i, span);
    const auto hit = rays.intersect(ray);
    EXPECT_EQ(hit.has_value(), rays.occluded(ray));
    if (!hit) continue;
    ++hits[hit->point.shape];
    const Vec3f p = rays.position(hit->point, ray.time);
    EXPECT_LT(length(p - (ray.o + ray.d * hit->t)), 2e-5f) << "shape " << hit->point.shape;
    const ShadingPoint s = rays.shading_point(hit->point, ray.time, -ray.d);
    EXPECT_EQ(s.p, p);
    EXPECT_NEAR(length(s.ng), 1, 1e-5);
    EXPECT_LT(std::abs(dot(s.frame.n, s.frame.s)), 1e-5f);
  }
  for (std::size_t k = 0; k < hits.size(); ++k) EXPECT_GT(hits[k], 300) << "shape " << k << " is hardly tested";
}

// The grid is global: RayScenes over different spans describe the same motion to the bit.
TEST(RayScene, OverlappingSpansAgreeExactly) {
  const Scene scene = everything_moves();
  GeometryCache cache;
  const RayScene a(scene, {0.25, 0.5}, {0, 1}, {.motion_step = 1.0 / 16}, cache);
  const RayScene b(scene, {0.5, 0.8}, {0.2, 0.9}, {.motion_step = 1.0 / 16}, cache);
  int tested = 0;
  for (std::uint64_t i = 0; i < 4000; ++i) {
    const auto hit = a.intersect(random_ray(i, {0.25, 0.5}));
    if (!hit) continue;
    ++tested;
    for (const double t : {0.21, 0.3, 0.5, 0.61, 0.89}) {
      EXPECT_EQ(a.position(hit->point, t), b.position(hit->point, t)) << "shape " << hit->point.shape << " time " << t;
      EXPECT_EQ(a.shading_point(hit->point, t, {0, 0, 1}).frame.n, b.shading_point(hit->point, t, {0, 0, 1}).frame.n);
    }
  }
  EXPECT_GT(tested, 1000);
}

// Derivatives against differences of points and shading normals at shifted coordinates: every kind of geometry and
// motion. Meshes without uvs take their barycentrics for them, so that both are coordinates of a SurfacePoint.
TEST(RayScene, DerivativesMatchFiniteDifferences) {
  Scene scene = everything_moves();
  for (Shape& shape : scene.shapes) {
    if (Mesh* mesh = std::get_if<Mesh>(&shape.geometry)) mesh->uvs.clear();
  }
  GeometryCache cache;
  const RayScene rays(scene, {0.25, 0.75}, {0, 1}, {.motion_step = 1.0 / 16}, cache);
  std::vector<int> tested(scene.shapes.size());
  for (std::uint64_t i = 0; i < 8000; ++i) {
    const Ray ray = random_ray(i, {0.25, 0.75});
    const auto hit = rays.intersect(ray);
    if (!hit || hit->point.v < 0.1f || hit->point.v > 0.9f) continue;  // poles
    const SurfaceDerivatives d = rays.derivatives(hit->point, ray.time);
    constexpr float kStep = 2e-3f;
    for (const bool along_v : {false, true}) {
      SurfacePoint a = hit->point, b = hit->point;
      (along_v ? a.v : a.u) -= kStep;
      (along_v ? b.v : b.u) += kStep;
      const Vec3f dp = (rays.position(b, ray.time) - rays.position(a, ray.time)) * (0.5f / kStep);
      const Vec3f dn =
          (rays.shading_point(b, ray.time, ray.d).frame.n - rays.shading_point(a, ray.time, ray.d).frame.n) *
          (0.5f / kStep);
      EXPECT_LT(length(dp - (along_v ? d.dpdv : d.dpdu)), 5e-3f * (1 + length(dp))) << "shape " << hit->point.shape;
      EXPECT_LT(length(dn - (along_v ? d.dndv : d.dndu)), 5e-3f * (1 + length(dn))) << "shape " << hit->point.shape;
    }
    ++tested[hit->point.shape];
  }
  for (std::size_t k = 0; k < tested.size(); ++k) EXPECT_GT(tested[k], 50) << "shape " << k;
}

TEST(RayScene, NormalsFollowTheSurface) {
  // Flat shading: the geometric normal from vertices must equal the one that instances transform.
  SceneBuilder b;
  Mesh cube = make_cube();
  Affine3d mirrored = scale(Vec3d{-1, 2, 0.5});
  b.add(cube, b.node(mirrored));
  b.add(cube, b.node(turning({1, 1, 0}, 2, {4, 0, 0}, {4, 1, 0}, {-1, 2, 1}, {-1, 1, 1})));
  GeometryCache cache;
  const RayScene rays(b.scene, {0, 1}, {0, 1}, {.motion_step = 1.0 / 16}, cache);
  for (const std::uint32_t instance : {0u, 1u}) {
    for (std::uint32_t t = 0; t < 12; ++t) {
      const SurfacePoint point{instance, instance, t, 0.3f, 0.3f};
      const Vec3f center = instance == 0 ? Vec3f{} : Vec3f(b.scene.world(b.scene.instances[1].node, 0.5).translation);
      Vec3f ng;
      const Vec3f p = rays.position(point, 0.5, &ng);
      EXPECT_GT(dot(ng, p - center), 0) << "a face of a mirrored cube points inwards";
      EXPECT_LT(length(rays.shading_point(point, 0.5, ng).ng - ng), 1e-5f);
    }
  }
}

TEST(RayScene, InstancesOfOneGroupShareGeometry) {
  SceneBuilder b;
  b.add(bumpy_sphere(128, 256), b.node(translate(Vec3d{0, 0, 0})));
  for (int i = 1; i < 1000; ++i) b.scene.instances.push_back({0, b.node(translate(Vec3d{3.0 * i, 0, 0})), "", true});
  GeometryCache cache;
  const RayScene rays(b.scene, {0, 0}, {0, 0}, {}, cache);
  // 65536 triangles take some 8 MB; a thousand copies may add only their instances.
  EXPECT_LT(rays.memory(), 40u << 20);
  const auto hit = rays.intersect({{2997, 0, 10}, {0, 0, -1}, 0, kInfinity, 0});
  ASSERT_TRUE(hit);
  EXPECT_EQ(hit->point.instance, 999u);
}

TEST(RayScene, ResamplingErrorFallsWithTheStep) {
  Scene scene = everything_moves();
  // Morph and cache keys fall between knots, where the error depends on where exactly: the others converge regularly.
  std::erase_if(scene.instances, [&](const Instance& i) {
    const auto* mesh = std::get_if<Mesh>(&scene.shapes[i.group].geometry);
    return mesh && (mesh->cache.samples || !mesh->morph_targets.empty());
  });
  double previous = kInfinity;
  for (const double step : {1.0 / 4, 1.0 / 8, 1.0 / 16}) {
    const auto metres = [](const Vec3f& a, const Vec3f& b, double) { return double(length(a - b)); };
    const TimeSpan span{0, 1};
    const double error = motion_errors(scene, {&span, 1}, step, metres)[0];
    EXPECT_GT(error, 0);
    EXPECT_LT(error, previous * 0.5);
    previous = error;
  }
}

TEST(RayScene, TooManySegmentsIsAnError) {
  const Scene scene = everything_moves();
  GeometryCache cache;
  try {
    const RayScene rays(scene, {0, 1}, {0, 1}, {.motion_step = 1.0 / 200}, cache);
    FAIL() << "built 200 segments";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::kOutOfRange);
  }
}

TEST(RayScene, HiddenNodesAreNotHit) {
  SceneBuilder b;
  b.scene.nodes.push_back({-1, {}, "", Animated<float>({0.0, 1.0}, {1.0f, 0.0f}, Interpolation::kStep)});
  b.add(bumpy_sphere(), 0);
  for (const double t : {0.5, 1.5}) {
    GeometryCache cache;
    const RayScene rays(b.scene, {t, t}, {t, t}, {}, cache);
    EXPECT_EQ(rays.occluded({{0, 0, 5}, {0, 0, -1}, 0, kInfinity, t}), t < 1);
  }
}

// Debian's Embree ends the program when it is given such rays.
TEST(RayScene, RaysThatAreNoneHitNothing) {
  SceneBuilder b;
  b.scene.nodes.push_back({});
  b.add(bumpy_sphere(), 0);
  GeometryCache cache;
  const RayScene rays(b.scene, {0, 0}, {0, 0}, {}, cache);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  ASSERT_TRUE(rays.occluded({{0, 0, 5}, {0, 0, -1}, 0, kInfinity, 0}));
  for (const Ray& r :
       {Ray{{nan, 0, 5}, {0, 0, -1}, 0, kInfinity, 0}, Ray{{0, 0, 5}, {0, nan, -1}, 0, kInfinity, 0},
        Ray{{0, 0, 5}, {0, 0, -kInfinity}, 0, kInfinity, 0}, Ray{{0, 1e30f, 5}, {0, 0, -1}, 0, kInfinity, 0},
        Ray{{0, 0, 5}, {0, 0, -1}, nan, kInfinity, 0}, Ray{{0, 0, 5}, {0, 0, -1}, 0, nan, 0}}) {
    EXPECT_FALSE(rays.intersect(r));
    EXPECT_FALSE(rays.occluded(r));
  }
}

}  // namespace
}  // namespace tempera
