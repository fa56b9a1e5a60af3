// SPDX-License-Identifier: Apache-2.0
// Stands for [Zimmer 2015, Fig. 14].
#include <fmt/format.h>

#include <cmath>

#include "builder.h"
#include "papers.h"

namespace tempera {

using namespace gallery;

namespace {

/// A standing screen with slots, cut out of one sheet of board.
Polygons slotted_panel() {
  Polygons out;
  constexpr double kHeight = 1.7, kDepth = 0.03;
  constexpr int kSlats = 9;
  for (int k = 0; k < kSlats; ++k) {
    const double wide = k % 3 == 1 ? 0.16 : 0.09;
    out.add(box({wide, kHeight, kDepth}), at({(k - kSlats / 2) * 0.25, kHeight / 2, 0}));
  }
  out.add(box({9 * 0.25, 0.10, kDepth * 1.2}), at({0, kHeight - 0.05, 0}));
  out.add(box({9 * 0.25, 0.10, kDepth * 1.2}), at({0, 0.05, 0}));
  out.add(box({9 * 0.25, 0.06, kDepth * 1.2}), at({0, kHeight * 0.55, 0}));
  return out;
}

void build(GalleryBuilder& b) {
  const Picture paving = paint(512, 512, [](double u, double v) {
    const Brick t = brick(u * 4, v * 4, 0.5, 0.5);
    const int row = t.row & 7, column = ((t.column % 4) + 4) % 4;
    const double tone = random(31, std::uint64_t(row), std::uint64_t(column));
    const Rgb base = mix(hex("#b9a58a"), hex("#8d7f70"), tone);
    const double rough = tiled_noise(u, v, 16, 5, 40);
    const Rgb stone = base * float(1 + 0.22 * rough);
    return mix(hex("#5e564c"), stone, smooth_step(0.008, 0.03, t.from_joint + 0.006 * rough));
  });
  const Picture plaster = paint(512, 256, [](double u, double v) {
    const double n = tiled_noise(u, v, 8, 6, 77);
    const Rgb upper = mix(hex("#cfc4ae"), hex("#b3a58c"), 0.5 + 0.5 * n),
              lower = mix(hex("#6f4a3c"), hex("#5c3b30"), 0.5 + 0.5 * n);
    return v + 0.012 * n > 0.62 ? lower : upper;
  });
  const int floor = b.material(
      {.name = "paving", .color = Rgb(1.0f), .texture = b.texture("paving", paving), .roughness = 1, .specular = 0});
  const int wall = b.material(
      {.name = "plaster", .color = Rgb(1.0f), .texture = b.texture("plaster", plaster), .roughness = 1, .specular = 0});
  const int stone = b.material({.name = "stone", .color = hex("#c9c0b0"), .specular = 0});
  const int panel = b.material({.name = "panel", .color = hex("#2f6f73"), .specular = 0});
  const int orange = b.material({.name = "orange", .color = hex("#d9772b"), .specular = 0});
  const int violet = b.material({.name = "violet", .color = hex("#6c4a8c"), .specular = 0});

  b.place("floor", floor_plane({28, 16}, {14, 8}), floor, {0, 0, 0});
  b.place("wall", wall_plane({28, 5}, {14, 1}), wall, {0, 2.5, -3.6});
  const std::vector<Vec2d> column{{0, 0},      {0.34, 0},    {0.34, 0.12}, {0.27, 0.16}, {0.25, 0.22},
                                  {0.22, 2.5}, {0.27, 2.56}, {0.33, 2.64}, {0.33, 2.8},  {0, 2.8}};
  const int pillar = b.mesh("pillar", lathe(column, 48), stone);
  for (int k = -3; k <= 3; ++k) b.place(fmt::format("pillar_{}", k + 4), pillar, {k * 2.7 + 0.9, 0, -2.7});
  const int plinth = b.mesh("plinth", rounded_box({0.5, 0.5, 0.5}, 0.02, 2), stone);
  for (int k = -3; k <= 3; ++k)
    b.place(fmt::format("plinth_{}", k + 4), plinth, {k * 2.9 - 0.6, 0.25, 1.9}, about_y(20.0 * k));

  // Two lamps at the sides of the stage, above the picture; what moves passes between them and the floor, in opposite
  // directions.
  b.lamp("lamp_small", {0.1, 0.1}, {13000, 11000, 8200}, {-4.6, 3.6, -1.6}, {0.8, -1, 0.5});
  b.lamp("lamp_wide", {0.6, 0.6}, {270, 320, 420}, {4.8, 3.9, -1.5}, {-0.8, -1, 0.5});
  const int screen = b.place("screen", slotted_panel(), panel);
  b.move(screen, [](double f) { return Vec3d{-3.2 + 6.4 * (f - 1) / 23, 0.02, 0.9}; });
  b.turn(screen, [](double f) { return about_y(-18 + 1.2 * f); });
  const int ball = b.mesh("ball", sphere(0.42, 64, 32), orange), second = b.mesh("second", sphere(0.3, 64, 32), violet);
  const int left = b.place("ball_orange", ball), right = b.place("ball_violet", second);
  b.move(left, [](double f) { return Vec3d{3.6 - 7.0 * (f - 1) / 23, 1.15 + 0.25 * std::sin(f * 0.4), 1.5}; });
  b.move(right, [](double f) { return Vec3d{2.2 - 6.4 * (f - 1) / 23, 0.62, 0.1}; });

  b.environment(Rgb(0.05f, 0.06f, 0.08f));
  // 40 pixels a frame of 640 at the center: the paper's picture has twice the size and moves by 80.
  constexpr double kFov = 19;
  const double focal = 180 / std::tan(kFov / 2 * kPiD / 180), step = std::atan(40 / focal);
  const Vec3d eye{0, 2.5, 9.6};
  b.camera(
      kFov, [=](double) { return eye; },
      [=](double f) {
        const double a = step * (f - 12.5);
        return eye + Vec3d{std::sin(a), -0.19, -std::cos(a)};
      });
}

}  // namespace

extern const GalleryScene moving_shadow_scene{
    .name = "moving-shadow",
    .title = "Shadows of a slotted screen and two balls cross each other on textured ground while the camera pans",
    .paper = &kZimmer2015,
    .figure = "Figure 14",
    .triangles = 15568,
    .max_depth = 6,
    .reference_spp = 4096,
    .classes = {{"dd", "ED", "direct light on diffuse surfaces: the shadows"}, {"di", "ED.+", "their indirect light"}},
    .decomposition = true,
    .camera_moves = true,
    .moving = {"screen", "ball_orange", "ball_violet"},
    .variants = {{"sharp",
                  "a shutter that is open for no time, as keys of frames in between need",
                  {{"shutter.open", "0.25"}, {"shutter.close", "0.25"}}}},
    .about =
        "Irradiance that moves against the texture it falls on. Two square lamps, 0.1 m and 0.6 m wide, throw the "
        "shadows of a screen with\n"
        "slots, which goes to the right, and of two balls, which go to the left. The camera pans by 40 of its 640 "
        "pixels a\n"
        "frame (80 of 1280). All surfaces are diffuse: what motion vectors of surfaces cannot follow is the light "
        "alone.\n",
    .build = build,
};

}  // namespace tempera
