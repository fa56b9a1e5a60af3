// SPDX-License-Identifier: Apache-2.0
// What photons cost, on one thread: tracing them through a ball of glass (two specular events each), the map's memory, and
// asking it what arrives at points of the caustic and around it.
//
//   photon_rate [PHOTONS] [OVERLAP]
#include <fmt/format.h>

#include <chrono>
#include <cstdlib>

#include "tempera/core/parallel.h"
#include "tempera/photons/photon_map.h"
#include "tempera/transport/frame_scene.h"

using namespace tempera;

namespace {

template <class F>
double seconds_of(F&& body) {
  const auto start = std::chrono::steady_clock::now();
  body();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

Scene make_scene() {
  Scene scene;
  const auto add = [&](Geometry geometry, MaterialPtr material, int node) {
    scene.shapes.push_back({std::move(geometry), std::move(material), std::nullopt, "", ""});
    scene.groups.push_back({int(scene.shapes.size()) - 1});
    scene.instances.push_back({int(scene.groups.size()) - 1, node, "shape", true});
  };
  AnimatedTransform moving;
  moving.keyed = true;
  moving.translation = {{0, 1}, {Vec3d{0, 0, 1.2}, Vec3d{1, 0, 1.2}}, Interpolation::kLinear};
  scene.nodes.push_back({-1, moving, "ball", 1.0f});
  scene.nodes.push_back(
      {-1, AnimatedTransform(Affine3d(look_at(Vec3f{0, 0, 6}, Vec3f{0, 0, 0}, Vec3f{0, 1, 0}))), "light", 1.0f});
  add(Sphere{}, make_dielectric({}), 0);
  Mesh ground = make_rectangle();
  for (Vec3f& p : ground.positions) p *= 5.0f;
  add(ground, make_diffuse(0.8f), -1);
  PunctualLight light;
  light.type = LightType::kDirectional;
  light.node = 1;
  scene.lights.push_back(light);
  Camera camera;
  camera.node = 1;
  scene.cameras.push_back(camera);
  return scene;
}

}  // namespace

int main(int argc, char** argv) {
  const std::int64_t count = argc > 1 ? std::atoll(argv[1]) : 1000000;
  PhotonOptions options;
  options.overlap = argc > 2 ? std::atof(argv[2]) : 0;
  const Scene scene = make_scene();
  RenderSettings settings;
  settings.clock.shutter = {.open = 0, .close = 1};
  GeometryCache cache;
  const LightPathClassifier classifier({kPhotonPaths});
  const FrameScene frame(scene, settings, classifier, 0, 1.0 / 96, cache);
  with_threads(1, [&] {
    const TimeSpan span = settings.clock.exposure(0);
    const PhotonTracer tracer(frame.context(), options, span, 0, count, 100);
    std::vector<Photon> photons;
    PhotonCounts counts;
    std::uint64_t rays = 0;
    const double traced = seconds_of([&] {
      for (std::int64_t i = 0; i < tracer.photons(); ++i) tracer.trace(i, photons, counts, rays);
    });
    std::optional<PhotonMap> map;
    const double built =
        seconds_of([&] { map.emplace(tracer, std::move(photons), classifier, frame.context().rays, false); });
    Vertex v;
    v.hit.point.instance = v.hit.point.shape = 1;
    v.s.ng = {0, 0, 1};
    std::vector<GatheredLight::Arrival> arrivals;
    constexpr int kSide = 400;
    int covered = 0;
    const double gathered = seconds_of([&] {
      for (int i = 0; i < kSide * kSide; ++i) {
        const int x = i % kSide, y = i / kSide;
        v.s.p = {-1.5f + 3 * (float(x) + 0.5f) / kSide, -1.5f + 3 * (float(y) + 0.5f) / kSide, 0};
        map->gather(v, 0.5 * (span.begin + span.end), -1, false, 100, arrivals);
        covered += !arrivals.empty();
      }
    });
    const double stored = double(counts.stored);
    fmt::print("{} photons emitted, {} stored, {} rays\n", counts.emitted, counts.stored, rays);
    fmt::print("tracing: {:.2f} s per million emitted\n", 1e6 * traced / double(count));
    fmt::print("map: {:.2f} s per million stored, {:.0f} MB per million\n", 1e6 * built / stored,
               double(map->memory()) / stored);
    fmt::print("gather: {:.2f} us a query, {:.0f} % of the queries find photons\n", 1e6 * gathered / (kSide * kSide),
               100.0 * covered / (kSide * kSide));
  });
}
