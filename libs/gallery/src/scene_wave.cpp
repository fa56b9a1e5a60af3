// SPDX-License-Identifier: Apache-2.0
// Stands for [Schjoth 2010, Figs. 5 and 6].
#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

// Scene W of the photon study, with y up: x stays, its y is our -z.
constexpr double kAmplitude = 0.05, kLength = 1, kLevel = 2, kSpeed = 0.1;  // metres; metres per frame
constexpr double kNumber = 2 * kPiD / kLength;
constexpr int kColumns = 512;     // 64 a wavelength
constexpr double kSunRadius = 4;  // degrees

/// The wave at phase 0 as it is.
Polygons frozen() {
  Polygons out = sheet(kColumns, 1, [](double u, double v) {
    const double x = 8 * u - 4;
    return Vec3d{x, kAmplitude * std::sin(kNumber * x), 3 - 6 * v};
  });
  for (std::size_t i = 0; i < out.positions.size(); ++i)
    out.normals[i] = Vec3f(normalize(Vec3d{-kAmplitude * kNumber * std::cos(kNumber * out.positions[i].x), 1, 0}));
  return out;
}

/// Still water and two displacements of which sin(k (x - c t)) = sin(kx) cos(kct) - cos(kx) sin(kct) is a sum; the
/// normals before normalization are the same sum.
Polygons standing() {
  Polygons out = floor_plane({8, 6}, {1, 1}, kColumns, 1);
  out.targets.resize(2);
  for (const Vec3f& p : out.positions) {
    const double s = std::sin(kNumber * p.x), c = std::cos(kNumber * p.x), k = kAmplitude * kNumber;
    out.targets[0].positions.emplace_back(Vec3d{0, kAmplitude * s, 0});
    out.targets[0].normals.emplace_back(Vec3d{-k * c, 0, 0});
    out.targets[1].positions.emplace_back(Vec3d{0, -kAmplitude * c, 0});
    out.targets[1].normals.emplace_back(Vec3d{-k * s, 0, 0});
  }
  return out;
}

enum class Water { kTranslated, kVertical };
enum class Light { kSun, kCollimated };

void fill(GalleryBuilder& b, Water motion, Light light) {
  const int sand =
      b.material({.name = "floor", .color = Rgb(0.8f), .specular = 0}, "type = \"diffuse\"\nreflectance = 0.8\n");
  const int tiles = b.material({.name = "wall", .color = {0.10f, 0.26f, 0.34f}, .specular = 0});
  const int stone = b.material({.name = "edge", .color = hex("#c9b79c"), .specular = 0});
  const int water = b.glass("water", 1.33);

  b.place("floor", floor_plane({8.4, 6.4}), sand);
  Polygons walls, edge;
  for (const double side : {-1.0, 1.0}) {
    walls.add(wall_plane({8.4, 2.3}), turned({0, 1, 0}, side < 0 ? 0 : 180, {0, 1.15, 3.2 * side}));
    walls.add(wall_plane({6.4, 2.3}), turned({0, 1, 0}, -90 * side, {4.2 * side, 1.15, 0}));
    edge.add(box({9.0, 0.12, 0.3}), at({0, 2.36, side * 3.35}));
    edge.add(box({0.3, 0.12, 6.4}), at({side * 4.35, 2.36, 0}));
  }
  b.place("walls", walls, tiles);
  b.place("edge", edge, stone);

  if (motion == Water::kTranslated) {
    b.move(b.place("wave", frozen(), water), [](double f) { return Vec3d{kSpeed * f, kLevel, 0}; });
  } else {
    const int wave = b.place("wave", standing(), water, {0, kLevel, 0});
    b.morph(wave, [](double f) {
      const double phase = kNumber * kSpeed * f;
      return std::vector<double>{std::cos(phase), std::sin(phase)};
    });
  }
  if (light == Light::kCollimated) {
    const int collimated = b.glb().directional_light("collimated", Rgb(kPi));
    b.glb().node({.name = "collimated", .translation = {0, 5, 0}, .rotation = about_x(-90), .light = collimated});
  }
  b.camera(40, {0, 1.2, 3}, {0, 0, 0});
  b.camera_above("above", {0, 1.5, 0}, {2, 2});
}

void build(GalleryBuilder& b) {
  fill(b, Water::kTranslated, Light::kSun);
  b.start_file("scene_vertical.glb");
  fill(b, Water::kVertical, Light::kSun);
  b.start_file("scene_collimated.glb");
  fill(b, Water::kTranslated, Light::kCollimated);
  b.exposure(-1.5);
  b.environment(sky(512, {0, 1, 0}, kSunRadius, 0.95, kPiD / 0.95, {0.30f, 0.42f, 0.60f}, {0.60f, 0.66f, 0.72f},
                    {0.2f, 0.2f, 0.2f}, Rgb(1.0f)));
}

}  // namespace

extern const GalleryScene wave_scene{
    .name = "wave",
    .title = "A sinusoidal wave wanders over a pool and focuses light from straight above onto its floor",
    .paper = &kSchjoth2010,
    .figure = "Figures 5 and 6",
    .triangles = 1082,
    .shutter_close = 1,
    .spp = 128,
    .max_depth = 8,
    .reference_spp = 16384,
    .classes = {{"caustic", "ED[RT]+", "light that the water focuses onto the floor"},
                {"rest", "ED.*D.*", "light that the pool reflects further"}},
    .decomposition = true,
    .moving = {"wave"},
    .variants = {{"collimated",
                  "exactly collimated light: `path` cannot find its caustic, methods that start at the light can",
                  {{"scene", "\"scene_collimated.glb\""},
                   {"environment.image", ""},
                   {"environment.radiance", "[0.02, 0.03, 0.045]"}}},
                 {"vertical",
                  "the same wave made by vertices that move up and down, as morph targets",
                  {{"scene", "\"scene_vertical.glb\""}}}},
    .about =
        "The surface is y = 2 + 0.05 sin(2 pi (x - 0.1 f)) at frame f, over x from -4 to 4 and z from -3 to 3, in "
        "steps of 1/64 of the\n"
        "wavelength with the wave's own normals; the index of the water is 1.33 and the crests' focal length 2.04 m. "
        "The floor is diffuse with\n"
        "reflectance 0.8. The exposure is the whole frame. The camera stands under water at (0, 1.2, 3), looks at the\n"
        "origin and sees 40 degrees; the camera `above` looks straight down on 2 m x 2 m of the floor.\n\n"
        "The paper's light is collimated. No path that starts at the camera finds such a light through water, so the "
        "scene has a\n"
        "sun of 4 degrees in radius in its place, of the same irradiance pi, and the variant `collimated` the paper's. "
        "Reflection at the\n"
        "surface follows Fresnel; the numbers that the study states leave it out. The walls of the pool are ours.\n",
    .build = build,
};

}  // namespace tempera
