// SPDX-License-Identifier: Apache-2.0
// Maps that estimate light from the photons nearest to a point, against all photons one by one.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "tempera/photons/photon_map.h"
#include "tempera/transport/frame_scene.h"

namespace tempera {
namespace {

TEST(PointIndex, FindsWhatIsNear) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> uniform(-1, 1);
  for (const int count : {0, 1, 2, 3, 7, 100, 3000}) {
    std::vector<Vec3f> points;
    for (int i = 0; i < count; ++i) {
      // A quarter of them in few places, so that many are at one distance.
      if (i % 4 == 0)
        points.push_back({0.25f * float(random() % 5), 0.5f, 0});
      else
        points.push_back({uniform(random), uniform(random), 0.1f * uniform(random)});
    }
    const PointIndex index(points);
    for (int k = 0; k < 50; ++k) {
      const Vec3f p = k % 2 ? Vec3f{uniform(random), uniform(random), 0} : Vec3f{0.25f * float(random() % 5), 0.5f, 0};
      std::vector<float> distances;
      for (const Vec3f& q : points) distances.push_back(length_squared(p - q));
      constexpr float kReach = 0.3f;
      std::vector<int> visits(points.size());
      index.visit(p, kReach, [&](std::size_t i, float d2) {
        EXPECT_EQ(d2, distances[i]);
        ++visits[i];
        return kReach;
      });
      for (std::size_t i = 0; i < points.size(); ++i) EXPECT_EQ(visits[i], distances[i] <= kReach);
      std::sort(distances.begin(), distances.end());
      for (const std::size_t nearest : {1u, 5u, 60u}) {
        std::vector<float> room;
        NearestDistance found(nearest, kReach, room);
        index.visit(p, found.reach(), [&](std::size_t, float d2) {
          found.add(d2);
          return found.reach();
        });
        const float expected = nearest <= points.size() ? std::min(distances[nearest - 1], kReach) : kReach;
        EXPECT_EQ(found.reach(), expected);
      }
    }
  }
}

/// Still water over the ground in light from straight above: the same everywhere.
struct Water {
  Scene scene;
  RenderSettings settings;
  GeometryCache cache;
  LightPathClassifier classifier{{kPhotonPaths}};
  std::optional<FrameScene> frame;

  explicit Water(bool halves) {
    scene.nodes.push_back(
        {-1, AnimatedTransform(Affine3d(look_at(Vec3f{0, 0, 3}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0}))), "light", 1.0f});
    const auto add = [&](float size, float z, MaterialPtr material) {
      Mesh m = make_rectangle();
      for (Vec3f& p : m.positions) p = p * size + Vec3f{0, 0, z};
      scene.shapes.push_back({std::move(m), std::move(material), std::nullopt, "", ""});
      scene.groups.push_back({int(scene.shapes.size()) - 1});
      scene.instances.push_back({int(scene.groups.size()) - 1, -1, "shape", true});
    };
    DielectricParams water;
    water.int_ior = 1.33f, water.ext_ior = 1;
    add(1.5f, 1, make_dielectric(water));
    add(3.0f, 0, make_diffuse(0.8f));
    PunctualLight light;
    light.type = LightType::kDirectional;
    light.intensity = Rgb(1.0f);
    light.node = 0;
    scene.lights.push_back(light);
    Camera camera;
    camera.node = 0;
    scene.cameras.push_back(camera);
    settings.clock.fps = 1;
    if (halves) settings.layers = {"color", "color.a", "color.b"};
    frame.emplace(scene, settings, classifier, 0, 1.0 / 16, cache);
  }
  PhotonMap map(const PhotonOptions& options) const {
    const PhotonTracer tracer(frame->context(), options, settings.clock.exposure(0), 0, 20000, 100);
    std::vector<Photon> stored;
    PhotonCounts counts;
    std::uint64_t rays = 0;
    for (std::int64_t i = 0; i < tracer.photons(); ++i) tracer.trace(i, stored, counts, rays);
    return {tracer, std::move(stored), classifier, frame->context().rays, false};
  }
  static Vertex ground(float x, float y) {
    Vertex v;
    v.hit.point.instance = v.hit.point.shape = 1;
    v.s.p = {x, y, 0};
    v.s.ng = {0, 0, 1};
    return v;
  }
};

PhotonOptions nearest_of(int k, double radius, SpatialKernel kernel) {
  PhotonOptions options;
  options.discs = true;
  options.temporal = false;
  options.nearest = k;
  options.radius = radius;
  options.kernel = kernel;
  return options;
}

double irradiance(const PhotonMap& map, const Vertex& v, int half) {
  std::vector<GatheredLight::Arrival> arrivals;
  map.gather(v, 0, half, false, 100, arrivals);
  double sum = 0;
  for (const auto& a : arrivals) sum += double(a.irradiance.g);
  return sum;
}

TEST(NearestPhotons, AreTheSameAsOneByOne) {
  for (const bool halves : {false, true}) {
    const Water water(halves);
    for (const double radius : {0.4, 0.05}) {
      const SpatialKernel kernel = radius > 0.1 ? SpatialKernel::kEpanechnikov : SpatialKernel::kUniform;
      const PhotonMap map = water.map(nearest_of(50, radius, kernel));
      std::mt19937 random(1);
      std::uniform_real_distribution<float> uniform(-1.6f, 1.6f);  // a little beyond the light
      for (int i = 0; i < 100; ++i) {
        const Vertex v = Water::ground(uniform(random), uniform(random));
        for (int half = -1; half < (halves ? 2 : 0); ++half) {
          std::vector<std::pair<float, double>> all;
          for (const Photon& p : map.photons()) {
            const float d2 = length_squared(p.footprint.center - v.s.p);
            if ((half < 0 || p.half == half) && d2 <= sqr(float(radius))) all.emplace_back(d2, p.flux.g);
          }
          std::sort(all.begin(), all.end());
          const double r2 = all.size() >= 50 ? double(all[49].first) : radius * radius;
          double expected = 0;
          for (const auto& [d2, flux] : all)
            expected += flux * double(spatial_kernel(kernel, float(double(d2) / r2))) / (kPiD * r2);
          if (half >= 0) expected *= 2;
          EXPECT_NEAR(irradiance(map, v, half), expected, 1e-4 * expected + 1e-6);
        }
      }
    }
  }
}

TEST(NearestPhotons, OfEvenLightHaveItsDensity) {
  const Water water(false);
  const double expected = 1 - sqr(0.33 / 2.33);
  for (const SpatialKernel kernel : {SpatialKernel::kUniform, SpatialKernel::kEpanechnikov, SpatialKernel::kGaussian}) {
    const PhotonMap map = water.map(nearest_of(40, 0.4, kernel));
    double mean = 0, squares = 0;
    constexpr int kSide = 30;
    for (int i = 0; i < kSide * kSide; ++i) {
      const double e = irradiance(
          map, Water::ground(-1.03f + 2.06f * float(i % kSide) / kSide, -1.03f + 2.06f * float(i / kSide) / kSide), -1);
      mean += e / sqr(kSide), squares += e * e / sqr(kSide);
    }
    // Photons are spread more evenly than by chance, which a count up to the k-th one takes half a photon from.
    EXPECT_NEAR(mean / expected, 1, 0.5 / 40 + 0.005) << int(kernel);
    EXPECT_LT(std::sqrt(squares - mean * mean) / mean, 0.2) << int(kernel);
  }
}

}  // namespace
}  // namespace tempera
