// SPDX-License-Identifier: Apache-2.0
#pragma once
// Scenes of lights for tests.
#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include "tempera/core/random.h"
#include "tempera/paths/light_sampler.h"

namespace tempera::test {

inline float number(std::uint64_t i, std::uint64_t j) { return to_unit_float(std::uint32_t(hash_key(i, j) >> 32)); }
inline Vec3f direction(double u, double v) {
  const double z = 2 * u - 1, r = std::sqrt(1 - z * z), phi = 2 * kPiD * v;
  return Vec3f(Vec3d{r * std::cos(phi), r * std::sin(phi), z});
}

/// A scene of lights, its rays at time 0 to 1, and the sampler.
struct Lights {
  Scene scene;
  GeometryCache cache;
  std::unique_ptr<RayScene> rays;
  std::unique_ptr<LightSampler> sampler;

  void add(Geometry g, float radiance, bool two_sided = false) {
    scene.groups.push_back({int(scene.shapes.size())});
    scene.instances.push_back({.group = int(scene.shapes.size())});
    scene.shapes.push_back({std::move(g), make_black(), AreaEmission{Slot(radiance), two_sided}, "", ""});
  }
  void build() {
    scene.cameras.emplace_back();
    validate(scene);
    const TimeSpan second{0, 1};
    rays = std::make_unique<RayScene>(scene, second, second, RaySceneOptions{.motion_step = 0.25}, cache);
    sampler = std::make_unique<LightSampler>(scene, *rays);
  }
  std::optional<LightSample> sample(const Vec3f& p, double t, std::uint64_t i) const {
    return sampler->sample(p, t, number(i, 1), {number(i, 2), number(i, 3)});
  }
  /// Radiance that arrives at p from direction d, and the density with which sample() picks d.
  std::pair<float, float> look(const Vec3f& p, const Vec3f& d, double t) const {
    float radiance = 0, pdf = 0;
    const auto hit = rays->intersect({.o = p, .d = d, .time = t});
    if (hit) {
      const ShadingPoint s = rays->shading_point(hit->point, t, -d);
      radiance = sampler->emitted(hit->point, s).r;
      pdf = sampler->pdf(hit->point, s, p, hit->t);
    } else if (sampler->has_environment()) {
      radiance = sampler->environment(d, t).r;
    }
    if (sampler->has_environment()) pdf += sampler->environment_pdf(d, t, p);
    return {radiance, pdf};
  }
};

inline Affine3f placed(const Vec3f& s, const Vec3f& at) {
  const Affine3d m = translate(Vec3d(at)) * Affine3d(look_at(Vec3f{0, 0, 0}, Vec3f{0.3f, -0.2f, -1}, Vec3f{0, 1, 0})) *
                     scale(Vec3d(s));
  return Affine3f(m);
}

inline Geometry mesh(Mesh m, const Affine3f& at) {
  transform(m, Affine3d(at));
  return m;
}

inline PunctualLight lamp(LightType type, float intensity) {
  PunctualLight light;
  light.type = type;
  light.intensity = Rgb(intensity);
  light.beam_width = 0.4f;
  light.cutoff_angle = 1.2f;
  return light;
}

}  // namespace tempera::test
