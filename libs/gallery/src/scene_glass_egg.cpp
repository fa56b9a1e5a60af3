// SPDX-License-Identifier: Apache-2.0
// Stands for [Woestijne 2017, Fig. 7].
#include <cmath>

#include "builder.h"
#include "papers.h"

namespace tempera {

using namespace gallery;

namespace {

constexpr double kRadius = 0.09, kHeight = 0.25;
constexpr double kTravel = 1.5 * 2 * kRadius;

/// An egg standing on its blunt end at the origin.
Polygons egg() {
  std::vector<Vec2d> profile;
  constexpr int kRings = 48;
  for (int k = 0; k <= kRings; ++k) {
    const double a = kPiD * k / kRings, y = -std::cos(a);
    // A sphere whose upper half is drawn out.
    const double radius = std::sin(a) * (1 - 0.16 * y - 0.04 * y * y);
    profile.push_back({k == 0 || k == kRings ? 0 : kRadius * radius, kHeight * (0.5 + 0.5 * y)});
  }
  return lathe(profile, 96, 60);
}

void build(GalleryBuilder& b) {
  const Rgb dark = hex("#3d2417"), light = hex("#e8dcc4");
  const Picture top = paint(768, 512, [&](double u, double v) {
    const double x = u * 12, y = v * 8;
    const Brick square = brick(x, y, 1, 0);
    const int odd = checker(x, y);
    const double grain = fractal_noise({x * 0.7 + 7 * square.row, y * 6, 3.0 * square.column}, 4, 5);
    const Rgb wood = mix(odd ? dark : light, odd ? hex("#5b3a24") : hex("#cdbb95"), 0.5 + 0.5 * grain);
    const bool border = u < 1 / 12.0 || u > 11 / 12.0 || v < 1 / 8.0 || v > 7 / 8.0;
    const Rgb edge = mix(hex("#6b4529"), hex("#4b2e1a"), 0.5 + 0.6 * fractal_noise({u * 6, v * 70, 1}, 4, 9));
    return (border ? edge : wood) * float(0.8 + 0.2 * smooth_step(0, 0.02, square.from_joint));
  });
  const int board =
      b.material({.name = "board", .color = Rgb(1.0f), .texture = b.texture("board", top), .roughness = 0.55});
  const int wood = b.material({.name = "wood", .color = hex("#4b2e1a"), .roughness = 0.5});
  const int wall = b.material({.name = "wall", .color = hex("#8d9aa3"), .roughness = 0.9});
  const int shade = b.material({.name = "shade", .color = hex("#26292c"), .roughness = 0.4});
  const int glass = b.glass("glass", 1.5);

  Polygons slab = rounded_box({1.2, 0.04, 0.8}, 0.012, 4);
  b.place("slab", slab, wood, {0, -0.0215, 0});
  b.place("board", floor_plane({1.17, 0.77}), board, {0, -0.001, 0});
  // A sheet that turns from a floor into a wall.
  const Polygons backdrop = sheet(1, 24, [](double u, double v) {
    constexpr double kBend = 0.8;
    const double s = v * 6.4 - 2.4, x = (u - 0.5) * 9, quarter = kPiD / 2 * kBend;
    if (s < 0) return Vec3d{x, 0, -s};
    if (s < quarter) return Vec3d{x, kBend * (1 - std::cos(s / kBend)), -kBend * std::sin(s / kBend)};
    return Vec3d{x, kBend + s - quarter, -kBend};
  });
  b.place("backdrop", backdrop, wall, {0, -0.35, -1.0});

  // The lamp: a square of 10 cm in the mouth of a shade.
  const Vec3d lamp_at{-0.34, 0.92, -0.12};
  const Quatd down = about_z(22);
  b.lamp("lamp", {0.1, 0.1}, {330, 280, 215}, lamp_at, rotation(down).vector({0, -1, 0}));
  const std::vector<Vec2d> bell{{0.105, -0.015}, {0.112, -0.012}, {0.098, 0.045}, {0.05, 0.09},
                                {0.02, 0.10},    {0.02, 0.6},     {0, 0.6}};
  b.place("shade", lathe(bell, 48, 50), shade, lamp_at, down);

  const int holder = b.group("path");
  b.move(holder, [](double f) { return Vec3d{-kTravel / 2 + kTravel * (f - 1) / 24, 0.0005, 0.02}; });
  const int body = b.place("egg", egg(), glass, {}, {}, holder);
  b.turn(body, [](double f) { return about_y(90.0 * f / 24) * about_z(7 * std::sin(2 * kPiD * f / 12)); });

  b.environment(Rgb(0.08f, 0.09f, 0.11f));
  b.camera(24, {0.30, 0.40, 1.02}, {-0.01, 0.085, 0.0});
}

}  // namespace

extern const GalleryScene glass_egg_scene{
    .name = "glass-egg",
    .title = "A glass egg glides over a chequered table under a small lamp",
    .paper = &kWoestijne2017,
    .figure = "Figure 7",
    .triangles = 10578,
    .max_depth = 16,
    .reference_spp = 16384,
    .classes = {{"caustic", "ED[RT]+", "light that the egg focuses onto the table"},
                {"through", "ETTD.*", "the table seen through the egg"},
                {"through_caustic", "E[RT]+D[RT]+", "caustics seen through the egg"}},
    .moving = {"egg"},
    .variants = {{"blur",
                  "one picture whose exposure holds the whole motion, as in the figure",
                  {{"frames", "\"0\""}, {"fps", "1"}, {"shutter.open", "0.0416667"}, {"shutter.close", "1.0416667"}}}},
    .about =
        "The paper's scene is one of Bitterli's with a moving glass egg; it states neither its motion nor its sizes. "
        "Here an egg of solid\n"
        "glass (index 1.5, 18 cm wide, 25 cm tall) glides by 1.5 times its width in 24 frames, turns by 90 degrees and "
        "sways by 7. The lamp\n"
        "is a square of 10 cm, 0.9 m above the table. `path` finds the caustic only where diffuse reflection happens "
        "to meet the lamp\n"
        "through the egg, so it is noisy: that is the point of the scene.\n",
    .build = build,
};

}  // namespace tempera
