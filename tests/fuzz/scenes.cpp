// SPDX-License-Identifier: Apache-2.0
#include <string>
#include <variant>

#include "entries.h"
#include "tempera/accel/ray_scene.h"
#include "tempera/core/random.h"
#include "tempera/import/import.h"
#include "tempera/paths/camera_model.h"
#include "tempera/paths/light_sampler.h"

namespace tempera::fuzz {
namespace {

float random1(std::uint64_t i, std::uint64_t j) { return to_unit_float(std::uint32_t(hash_key(i, j))); }

}  // namespace

void exercise(const Scene& scene, std::string_view input) {
#ifdef TEMPERA_FUZZ_SPARSELY
  if (std::hash<std::string_view>{}(input) % 4) return;
#endif
  // Small scenes find as many mistakes as large ones, and more of them a second.
  std::size_t triangles = 0;
  for (const Shape& s : scene.shapes) {
    if (const auto* mesh = std::get_if<Mesh>(&s.geometry)) triangles += mesh->triangle_count();
  }
  if (triangles > 5000 || scene.instances.size() > 200 || scene.nodes.size() > 2000) return;

  constexpr double kStep = 1.0 / 96;
  const double begin = std::clamp(scene.animation.begin, -1e3, 1e3);
  const TimeSpan exposure{begin, begin + 2 * kStep}, evaluation{begin - 4 * kStep, begin + 6 * kStep};
  GeometryCache cache;
  const std::vector<TimeSpan> pieces = exposure_pieces(scene, exposure, kStep);
  const TimeSpan piece = pieces[std::hash<std::string_view>{}(input) % pieces.size()];
  const RayScene rays(scene, piece, evaluation, {.motion_step = kStep}, cache);
  const LightSampler lights(scene, rays);

  const auto shoot = [&](const Vec3f& o, const Vec3f& d, std::uint64_t i) {
    if (!is_finite(o) || !is_finite(d)) return;
    const double t = piece.begin + piece.length() * random1(i, 2);
    (void)lights.environment(d, t);
    (void)lights.sample(o, t, random1(i, 3), {random1(i, 4), random1(i, 5)});
    const auto hit = rays.intersect({.o = o, .d = d, .time = t});
    if (!hit) return;
    (void)rays.surface(hit->point, hit->point.u, hit->point.v, evaluation.end);
    const ShadingPoint s = rays.shading_point(hit->point, t, -d);
    const Material& material = *rays.shape(hit->point).material;
    (void)material.opacity(s);
    (void)material.absorption(s);
    Bsdf bsdf;
    material.add_lobes(s, 1, bsdf);
    (void)bsdf.sample(s.wo, random1(i, 6), {random1(i, 7), random1(i, 8)});
    (void)lights.emitted(hit->point, s);
    (void)lights.pdf(hit->point, s, o, hit->t);
  };
  for (std::size_t c = 0; c < std::min<std::size_t>(scene.cameras.size(), 4); ++c) {
    const CameraModel camera(scene, int(c), 16, 9, evaluation, kStep);
    for (std::uint64_t i = 0; i < 8; ++i) {
      const CameraRay r = camera.ray({16 * random1(i, 0), 9 * random1(i, 1)}, {0.3f, 0.6f}, begin);
      (void)camera.project(r.o + r.d, evaluation.begin);
      shoot(r.o, r.d, i);
    }
  }
  const Bounds3f bounds = rays.bounds();
  for (std::uint64_t i = 100; i < 108 && !bounds.empty(); ++i) {
    const float z = 2 * random1(i, 0) - 1, phi = 2 * kPi * random1(i, 1), r = std::sqrt(1 - z * z);
    const Vec3f d{r * std::cos(phi), r * std::sin(phi), z};
    shoot(bounds.center() - d * (2 * bounds.radius()), d, i);
  }
}

void scene(std::string_view extension, std::string_view input) {
  const std::filesystem::path file = write_input("input" + std::string(extension), input);
  expect_bad_input_only([&] {
    Warnings warnings;
    ImportOptions options;
    options.sandbox = true;
    options.memory_limit = kMemoryLimit;
    const Scene imported = import_scene(file, options, warnings);
    warnings.report();
    exercise(imported, input);
  });
}

}  // namespace tempera::fuzz
