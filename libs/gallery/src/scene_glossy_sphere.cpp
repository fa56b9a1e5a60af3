// SPDX-License-Identifier: Apache-2.0
// Stands for [Zimmer 2015, the video's Glossy Sphere (Section 5.3)].
#include <cmath>

#include "builder.h"
#include "papers.h"

namespace tempera {

using namespace gallery;

namespace {

constexpr double kRadius = 0.3;

void build(GalleryBuilder& b) {
  const Picture tiles = paint(512, 512, [](double u, double v) {
    const double x = u * 4, y = v * 4;
    const Brick t = brick(x, y, 1, 0);
    const double vein = std::abs(fractal_noise({x * 1.3 + 11.0 * t.row, y * 1.3 + 5.0 * t.column, 0.5}, 5, 21));
    const Rgb stone = checker(x, y) ? mix(hex("#2b3036"), hex("#5a626b"), 0.25 * std::exp(-9 * vein) + 0.12)
                                    : mix(hex("#e6e1d8"), hex("#a79f92"), 0.7 * std::exp(-8 * vein));
    return stone * float(0.55 + 0.45 * smooth_step(0.004, 0.018, t.from_joint));
  });
  const int floor =
      b.material({.name = "floor", .color = Rgb(1.0f), .texture = b.texture("floor", tiles), .roughness = 0.7});
  const int red = b.material({.name = "red", .color = hex("#c1272d"), .roughness = 0.6});
  const int yellow = b.material({.name = "yellow", .color = hex("#e9b824"), .roughness = 0.6});
  const int blue = b.material({.name = "blue", .color = hex("#1f5fa8"), .roughness = 0.6});
  // Silver at 630, 550 and 460 nm.
  const int silver =
      b.material({.name = "silver", .color = {0.97f, 0.96f, 0.91f}, .roughness = std::sqrt(0.05), .metallic = 1},
                 "type = \"conductor\"\neta = [0.135, 0.125, 0.144]\nk = [3.99, 3.34, 2.56]\nroughness = 0.05\n");

  b.place("floor", floor_plane({60, 60}, {60, 60}), floor);
  b.place("box_red", rounded_box({0.42, 0.42, 0.42}, 0.015, 3), red, {-0.78, 0.21, -0.55}, about_y(24));
  b.place("box_yellow", rounded_box({0.34, 0.7, 0.34}, 0.015, 3), yellow, {0.05, 0.35, -0.85}, about_y(-12));
  b.place("box_blue", rounded_box({0.5, 0.3, 0.36}, 0.015, 3), blue, {0.82, 0.15, -0.35}, about_y(-33));
  b.lamp("lamp", {1, 1}, {14, 13, 11.5f}, {-0.9, 2.3, 0.9}, {0.42, -1, -0.40});

  // It rolls: a turn by distance over radius.
  const auto x = [](double f) { return -0.5 + (f - 1) / 48; };
  const int ball = b.place("ball", sphere(kRadius, 128, 64), silver);
  b.move(ball, [&](double f) { return Vec3d{x(f), kRadius, 0.05}; });
  b.turn(ball, [&](double f) { return about_z(-(x(f) + 0.5) / kRadius * 180 / kPiD); });

  b.environment(paint_environment(256, 128, [](const Vec3d& d) {
    const Rgb zenith{0.20f, 0.28f, 0.42f}, horizon{0.80f, 0.72f, 0.62f};
    return d.y < 0 ? Rgb(0.10f) : mix(horizon, zenith, std::pow(d.y, 0.5));
  }));
  b.camera(30, {0.25, 1.05, 2.55}, {0, 0.24, -0.1});
}

}  // namespace

extern const GalleryScene glossy_sphere_scene{
    .name = "glossy-sphere",
    .title = "A ball of rough silver rolls over a chequered floor between coloured boxes",
    .paper = &kZimmer2015,
    .figure = "the video's Glossy Sphere (Section 5.3)",
    .triangles = 17898,
    .last_frame = 48,
    .max_depth = 8,
    .reference_spp = 4096,
    .classes = {{"dd", "ED", "direct light on diffuse surfaces"},
                {"di", "ED.+", "their indirect light"},
                {"refl", "ERD.*", "what the ball reflects"}},
    .decomposition = true,
    .moving = {"ball"},
    .variants = {{"alpha-0", "a mirror: roughness 0", {{"materials.silver.roughness", "0.0"}}},
                 {"alpha-0.03", "roughness 0.03", {{"materials.silver.roughness", "0.03"}}},
                 {"alpha-0.09", "roughness 0.09", {{"materials.silver.roughness", "0.09"}}},
                 {"alpha-0.11",
                  "roughness 0.11, which counts as diffuse: its reflection belongs to `dd` and `di`",
                  {{"materials.silver.roughness", "0.11"}}}},
    .about =
        "Glossy surfaces are tracked as if they were mirrors; this scene shows how far that holds. The ball (radius "
        "0.3 m, GGX roughness\n"
        "alpha = 0.05) rolls 1 m in 48 frames. From alpha = 0.1 on, a lobe counts as diffuse, so that the last "
        "variant\n"
        "changes the decomposition.\n",
    .build = build,
};

}  // namespace tempera
