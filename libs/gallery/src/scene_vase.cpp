// SPDX-License-Identifier: Apache-2.0
// Stands for [Zimmer 2015, Fig. 13, bottom].
#include <algorithm>
#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

constexpr double kWall = 0.004;

/// Outside and inside of a vase of glass, one closed surface, its foot at the origin.
Polygons vase() {
  const std::vector<Vec2d> points{{0.062, 0.0},   {0.066, 0.006}, {0.060, 0.018}, {0.078, 0.060},
                                  {0.104, 0.115}, {0.112, 0.160}, {0.098, 0.212}, {0.068, 0.255},
                                  {0.052, 0.290}, {0.058, 0.322}, {0.078, 0.350}};
  const std::vector<Vec2d> outer = curve(points, 6);
  std::vector<Vec2d> inner;  // the outer profile moved inwards by the wall
  for (std::size_t i = 0; i < outer.size(); ++i) {
    const Vec2d a = outer[i > 0 ? i - 1 : 0], b = outer[std::min(i + 1, outer.size() - 1)], d = b - a;
    const Vec2d p = outer[i] + Vec2d{-d.y, d.x} * (kWall / length(d));
    if (p.y > 0.022) inner.push_back(p);
  }
  std::vector<Vec2d> profile{{0, 0.0}};
  profile.insert(profile.end(), outer.begin(), outer.end());
  // The rim: half a circle from the outer to the inner edge.
  const Vec2d a = outer.back(), b = inner.back(), middle = (a + b) / 2, arm = a - middle, up{-arm.y, arm.x};
  for (int k = 1; k < 8; ++k) {
    const double t = kPiD * k / 8;
    profile.push_back(middle + arm * std::cos(t) + up * std::sin(t));
  }
  profile.insert(profile.end(), inner.rbegin(), inner.rend());
  profile.push_back({0.03, 0.016});
  profile.push_back({0, 0.014});
  return lathe(profile, 128, 50);
}

void build(GalleryBuilder& b) {
  // A wall of tiles in five glazes: what the vase bends.
  const Picture tiles = paint(768, 512, [](double u, double v) {
    const double x = u * 12, y = v * 8;
    const Brick t = brick(x, y, 1, 0);
    const char* glazes[] = {"#1d5b79", "#e9dfc7", "#c8553d", "#f2b84b", "#2f8f83"};
    const Rgb ground = hex(glazes[std::size_t(random(3, std::uint64_t(t.row), std::uint64_t(t.column)) * 5)]);
    const Rgb ink = hex(glazes[std::size_t(random(4, std::uint64_t(t.row), std::uint64_t(t.column)) * 5)]);
    const double px = t.u - 0.5, py = t.v - 0.5, r = std::hypot(px, py), angle = std::atan2(py, px);
    bool figure = false;
    switch (int(random(5, std::uint64_t(t.row), std::uint64_t(t.column)) * 4)) {
      case 0:
        figure = std::abs(px) + std::abs(py) < 0.34 && std::abs(px) + std::abs(py) > 0.16;
        break;
      case 1:
        figure = r < 0.30 + 0.08 * std::cos(4 * angle);
        break;
      case 2:
        figure = (std::hypot(t.u, t.v) < 0.62) != (std::hypot(t.u, t.v) < 0.40);
        break;
      default:
        figure = std::abs(px - py) < 0.12 || std::abs(px + py) < 0.12;
    }
    const Rgb glaze = figure ? ink : ground;
    return mix(hex("#8d8678"), glaze, smooth_step(0.018, 0.03, t.from_joint));
  });
  const Picture cloth = paint(256, 256, [](double u, double v) {
    const double weave = 0.5 + 0.25 * std::sin(2 * kPiD * 64 * u) + 0.25 * std::sin(2 * kPiD * 64 * v);
    const bool stripe = std::fmod(u * 4, 1.0) < 0.12;
    return mix(stripe ? hex("#8f3d33") : hex("#d8cfbd"), hex("#b9ad97"), 0.35 * weave);
  });
  const int wall =
      b.material({.name = "tiles", .color = Rgb(1.0f), .texture = b.texture("tiles", tiles), .roughness = 0.6});
  const int table = b.material(
      {.name = "cloth", .color = Rgb(1.0f), .texture = b.texture("cloth", cloth), .roughness = 1, .specular = 0});
  const int brass = b.material({.name = "brass", .color = {0.89f, 0.62f, 0.27f}, .roughness = 0.38, .metallic = 1});
  const int glass = b.glass("glass", 1.5);

  b.place("wall", wall_plane({3.6, 2.4}), wall, {0, 0.45, -1.5});
  b.place("table", rounded_box({1.5, 0.03, 0.8}, 0.01, 3, 2.0), table, {0, -0.056, 0});
  b.lamp("lamp_left", {0.7, 0.9}, {10, 9.5f, 8.5f}, {-1.25, 0.95, 0.55}, {1.25, -0.75, -0.55});
  b.lamp("lamp_top", {1.2, 0.5}, {13, 12.5f, 11.5f}, {0.25, 1.65, -0.75}, {0, -1, 0});

  // A tilted turntable that slides along the table; the vase leans on it, so that it tumbles about the tilted axis.
  const int rail = b.group("rail");
  b.move(rail, [](double f) { return Vec3d{-0.1 + 0.2 * (f - 1) / 24, 0, 0}; });
  b.place(
      "foot",
      lathe(
          std::vector<Vec2d>{
              {0, -0.042}, {0.075, -0.042}, {0.078, -0.036}, {0.02, -0.024}, {0.016, -0.01}, {0.016, 0.02}, {0, 0.02}},
          48),
      brass, {}, {}, rail);
  const Quatd tilt = about_z(-9) * about_x(6);
  const int table_node = b.group("turntable", {0, 0.02, 0}, tilt, rail);
  const int spin = b.group("spindle", {}, {}, table_node);
  b.turn(spin, [](double f) { return about_y(90 * (f - 1) / 24); });
  b.place("plate", cylinder(0.088, -0.012, 0.0, 96, 0.004), brass, {}, {}, spin);
  b.place("vase", vase(), glass, {0, 0.0105, 0}, about_z(8), spin);

  b.environment(Rgb(0.16f, 0.165f, 0.18f));
  b.camera(23, {0.05, 0.30, 1.15}, {0.0, 0.165, 0});
}

}  // namespace

extern const GalleryScene vase_scene{
    .name = "vase",
    .title = "A thin glass vase tumbles on a tilted turntable before a tiled wall",
    .paper = &kZimmer2015,
    .figure = "Figure 13, bottom",
    .triangles = 32950,
    .max_depth = 16,
    .reference_spp = 8192,
    .classes = {{"dd", "ED", "direct light on diffuse surfaces"},
                {"di", "ED.+", "their indirect light"},
                {"refl", "ERD.*", "reflections on the outside and on the plate"},
                {"trans", "ETTD.*", "two refractions: through the foot and the rim"},
                {"trans4", "ETTTTD.*", "four refractions: the wall seen through the vase"}},
    .decomposition = true,
    .moving = {"vase", "plate", "foot"},
    .variants = {{"sharp",
                  "a shutter that is open for no time, as keys of frames in between need",
                  {{"shutter.open", "0.25"}, {"shutter.close", "0.25"}}}},
    .about =
        "The paper follows paths through four refractions, in and out of both walls of a vessel. The wall of this vase "
        "is 4 mm thick, its\n"
        "index 1.5, outside and inside one closed surface. The tiles stand 1.5 m behind it. The turntable is tilted by "
        "11\n"
        "degrees, turns by 90 degrees in 24 frames and slides 0.2 m; the vase leans by 8 degrees on it.\n",
    .build = build,
};

}  // namespace tempera
