// SPDX-License-Identifier: Apache-2.0
// Stands for [Manzi 2016, Figs. 6 and 11 (Running Man)].
#include <fmt/format.h>

#include <cmath>

#include "figure.h"
#include "papers.h"

namespace tempera {

using namespace gallery;

namespace {

constexpr double kBegin = -5, kEnd = 24;  // of the hall, along z

void build(GalleryBuilder& b) {
  b.keys(0, 4 * 26, 4);
  const Picture planks = paint(512, 512, [](double u, double v) {
    // Boards along v, 8 across and 2 in length.
    const Brick t = brick(v * 2, u * 8, 1, 0.37);
    const double tone = random(8, std::uint64_t(t.row & 7), std::uint64_t((t.column % 2 + 2) % 2));
    const double grain = fractal_noise({u * 60, v * 5 + 17 * tone, 9 * tone}, 4, 3);
    const Rgb wood = mix(hex("#b98a55"), hex("#8d6136"), std::clamp(0.35 * tone + 0.3 + 0.3 * grain, 0.0, 1.0));
    return wood * float(0.5 + 0.5 * smooth_step(0.0, 0.02, t.from_joint));
  });
  const Picture bricks = paint(512, 512, [](double u, double v) {
    const Brick t = brick(u * 4, v * 4, 1.0 / 3, 0.5);
    const double tone = random(12, std::uint64_t(t.row % 12), std::uint64_t((t.column % 4 + 4) % 4));
    const double n = tiled_noise(u, v, 32, 3, 6);
    const Rgb clay = mix(hex("#9c5a41"), hex("#c07a58"), tone) * float(1 + 0.2 * n);
    return mix(hex("#b8ab9a"), clay, smooth_step(0.012, 0.03, t.from_joint + 0.006 * n));
  });
  const int floor =
      b.material({.name = "floor", .color = Rgb(1.0f), .texture = b.texture("planks", planks), .roughness = 0.42});
  const int wall =
      b.material({.name = "bricks", .color = Rgb(1.0f), .texture = b.texture("bricks", bricks), .roughness = 0.95});
  const int plaster = b.material({.name = "plaster", .color = hex("#d8d2c4"), .roughness = 0.95});
  const int steel = b.material({.name = "steel", .color = hex("#3c5a6b"), .roughness = 0.5});
  const int line = b.material({.name = "line", .color = hex("#e9e4d6"), .roughness = 0.5});
  const int teal = b.material({.name = "banner_teal", .color = hex("#1c7f86"), .roughness = 0.9});
  const int ochre = b.material({.name = "banner_ochre", .color = hex("#d69a2d"), .roughness = 0.9});
  const int crimson = b.material({.name = "banner_crimson", .color = hex("#a12c3a"), .roughness = 0.9});

  const double middle = (kBegin + kEnd) / 2, size = kEnd - kBegin;
  b.place("floor", floor_plane({9, size}, {4.5, size / 2}), floor, {-1.9, 0, middle});
  b.place("ceiling", floor_plane({9, size}), plaster, {-1.9, 4.2, middle}, about_x(180));
  b.place("wall", wall_plane({size, 4.2}, {size, 4.2}), wall, {2.4, 2.1, middle}, about_y(-90));
  b.place("near_wall", wall_plane({size, 4.2}), plaster, {-6.4, 2.1, middle}, about_y(90));
  b.place("end_wall_1", wall_plane({9, 4.2}), plaster, {-1.9, 2.1, kBegin});
  b.place("end_wall_2", wall_plane({9, 4.2}), plaster, {-1.9, 2.1, kEnd}, about_y(180));
  for (const double x : {-0.75, 0.75})
    b.place(x < 0 ? "line_1" : "line_2", floor_plane({0.06, size}), line, {x, 0.002, middle});

  const int pillar = b.mesh("pillar", rounded_box({0.34, 4.2, 0.34}, 0.03, 2), steel);
  const int beam = b.mesh("beam", box({8.8, 0.34, 0.2}), steel);
  const int skirting = b.mesh("skirting", box({0.04, 0.16, size}), steel);
  b.place("skirting", skirting, {2.38, 0.08, middle});
  int banners[3];
  for (int k = 0; k < 3; ++k)
    banners[k] = b.mesh(fmt::format("banner_{}", k), box({0.03, 1.5, 0.8}), std::array{teal, ochre, crimson}[k]);
  int n = 0;
  for (double z = kBegin + 1; z < kEnd; z += 2.9, ++n) {
    const std::string id = fmt::format("_{}", n);
    b.place("pillar" + id, pillar, {2.2, 2.1, z});
    b.place("beam" + id, beam, {-1.9, 4.0, z});
    b.lamp("strip" + id, {0.34, 1.8}, {25, 23, 20}, {-0.6, 4.15, z + 1.45}, {0, -1, 0});
    b.place("banner" + id, banners[n % 3], {2.36, 2.15, z + 1.45});
  }
  // Benches along the wall.
  const int bench = b.mesh("bench", rounded_box({0.42, 0.08, 1.5}, 0.02, 2), line),
            leg = b.mesh("leg", box({0.38, 0.4, 0.06}), steel);
  n = 0;
  for (double z = kBegin + 2.45; z < kEnd - 1; z += 5.8, ++n) {
    const std::string id = fmt::format("_{}", n);
    b.place("bench" + id, bench, {1.95, 0.44, z});
    b.place("leg_a" + id, leg, {1.95, 0.2, z - 0.55});
    b.place("leg_b" + id, leg, {1.95, 0.2, z + 0.55});
  }

  std::array<int, kBodyPartCount> clothes;
  clothes[kSkin] = b.material({.name = "skin", .color = hex("#c08a68"), .roughness = 0.55});
  clothes[kShirt] = b.material({.name = "shirt", .color = hex("#e0541f"), .roughness = 0.85});
  clothes[kShorts] = b.material({.name = "shorts", .color = hex("#22314f"), .roughness = 0.85});
  clothes[kShoes] = b.material({.name = "shoes", .color = hex("#e8e6e1"), .roughness = 0.5});
  clothes[kHair] = b.material({.name = "hair", .color = hex("#2c1c12"), .roughness = 0.7});
  const Run run;
  const auto seconds = [](double f) { return f / 24; };
  place_figure(b, "runner", clothes, 0.0125, [&](double f) { return run.at(seconds(f)); });

  // The camera goes along at the mean speed, a little ahead.
  const auto z = [&](double f) { return run.speed() * seconds(f); };
  b.camera(
      30,
      [&](double f) {
        return Vec3d{-4.3, 1.25, z(f) + 1.3};
      },
      [&](double f) {
        return Vec3d{0, 0.98, z(f) + 0.12};
      });
}

}  // namespace

extern const GalleryScene running_figure_scene{
    .name = "running-figure",
    .title = "A figure runs through a hall while the camera goes along",
    .paper = &kManzi2016,
    .figure = "Figures 6 and 11 (Running Man)",
    .triangles = 38616,
    .spp = 32,
    .max_depth = 7,
    .reference_spp = 4096,
    .classes = {{"direct", "ED", "direct light"}, {"indirect", "ED.+", "light by more than one reflection"}},
    .camera_moves = true,
    .moving = {"runner"},
    .variants = {{"2x",
                  "twice as fast: half the frame rate at the same number of frames",
                  {{"fps", "12"}, {"video.fps", "24"}}},
                 {"4x", "four times as fast", {{"fps", "6"}, {"video.fps", "24"}}}},
    .about =
        "A skinned mesh with limbs that move much faster than the body. The paper compares its method at one, two and "
        "four times the speed of\n"
        "the animation; the variants do so by a lower frame rate, which lengthens exposure and motion alike. It "
        "rendered 32\n"
        "samples per pixel with its method against 80 of path tracing.\n\n"
        "The figure is made by code: blended solids, polygonized on a grid of 12.5 mm, with 17 joints. Its feet stand "
        "still\n"
        "while they touch the ground; it runs at 3.6 m/s with 0.66 s a stride.\n",
    .build = build,
};

}  // namespace tempera
