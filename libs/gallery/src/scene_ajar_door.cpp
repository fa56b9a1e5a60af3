// SPDX-License-Identifier: Apache-2.0
// Stands for [Woestijne 2017, Fig. 8].
#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

constexpr double kHeight = 2.6, kBack = -2.0;  // of the room, and the wall with the door
constexpr double kDoorLeft = -1.75, kDoorWide = 0.85, kDoorHigh = 2.02;

/// A door leaf with six raised panels, its hinge at the origin, along +x, its front towards +z.
Polygons door_leaf() {
  Polygons out = box({kDoorWide, kDoorHigh, 0.036}, 1);
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 2; ++column) {
      const double h = row == 0 ? 0.34 : 0.62, y = row == 0 ? 0.72 : row == 1 ? 0.13 : -0.62;
      const double x = (column - 0.5) * 0.38;
      for (const double side : {-1.0, 1.0}) {
        out.add(rounded_box({0.30, h, 0.02}, 0.008, 2), at({x, y, side * 0.018}));
        out.add(picture_frame({0.30, h}, 0.02, 0.016), turned({0, 1, 0}, side > 0 ? 0 : 180, {x, y, side * 0.018}));
      }
    }
  }
  Polygons placed;
  return placed.add(out, at({kDoorWide / 2, kDoorHigh / 2, 0}));
}

Polygons handle() {
  const std::vector<Vec3d> lever{{0, 0, 0.02}, {0, 0, 0.06}, {-0.012, 0, 0.068}, {-0.12, 0, 0.068}};
  const std::vector<double> radius{0.009};
  Polygons out = tube(lever, radius, 16);
  out.add(cylinder(0.028, 0, 0.012, 32, 0.004), turned({1, 0, 0}, 90, {0, 0, 0.018}));
  Polygons both = out;
  return both.add(out, scale(Vec3d{1, 1, -1}));
}

void build(GalleryBuilder& b) {
  const Picture tiles = paint(512, 512, [](double u, double v) {
    const double x = u * 2, y = v * 2;
    const Brick t = brick(x, y, 1, 0);
    const double vein = std::abs(tiled_noise(u, v, 4, 5, std::uint64_t(50 + checker(x, y))));
    const Rgb stone = checker(x, y) ? mix(hex("#23211f"), hex("#6d675f"), 0.6 * std::exp(-14 * vein))
                                    : mix(hex("#ddd5c5"), hex("#a6998a"), 0.7 * std::exp(-10 * vein));
    return stone * float(0.4 + 0.6 * smooth_step(0.004, 0.014, t.from_joint));
  });
  const Picture grain = paint(256, 512, [](double u, double v) {
    const double n = fractal_noise({u * 14, v * 1.6, 0.3}, 5, 61), ring = std::sin(22 * (u + 0.25 * n));
    return mix(hex("#7a4a28"), hex("#4f2d18"), 0.5 + 0.28 * ring + 0.3 * n);
  });
  const int floor =
      b.material({.name = "floor", .color = Rgb(1.0f), .texture = b.texture("tiles", tiles), .roughness = 0});
  const int wood_texture = b.texture("wood", grain);
  const int wood = b.material({.name = "wood", .color = Rgb(1.0f), .texture = wood_texture, .roughness = 0.45});
  const int table =
      b.material({.name = "table", .color = {0.9f, 0.75f, 0.6f}, .texture = wood_texture, .roughness = 0.35});
  const int wall = b.material({.name = "wall", .color = hex("#d9d0bd"), .specular = 0});
  const int white = b.material({.name = "white", .color = hex("#e8e4da"), .specular = 0});
  const int outside = b.material({.name = "corridor", .color = hex("#e6dcc8"), .specular = 0});
  const int china = b.material({.name = "china", .color = hex("#a63a2a"), .roughness = 0.12});
  const int steel =
      b.material({.name = "steel", .color = {0.95f, 0.95f, 0.95f}, .roughness = 0, .metallic = 1},
                 "type = \"conductor\"\neta = [2.76, 2.54, 2.27]\nk = [3.84, 3.43, 3.04]\nreflectance = 1.35\n");
  const int brass = b.material({.name = "brass", .color = {0.89f, 0.62f, 0.27f}, .roughness = 0.3, .metallic = 1});
  const int picture = b.material({.name = "picture",
                                  .color = Rgb(1.0f),
                                  .texture = b.texture("picture", landscape(384, 256, 4)),
                                  .roughness = 0.8});
  const int glass = b.glass("glass", 1.5);

  // The room, 5.2 m wide and 4.6 m deep; the wall at the back has the door.
  b.place("floor", floor_plane({5.2, 6.6}, {6.5, 8.25}), floor, {0, 0, -0.7});
  b.place("ceiling", floor_plane({5.2, 4.6}), white, {0, kHeight, 0.3}, about_x(180));
  Polygons walls;
  walls.add(wall_plane({4.6, kHeight}), turned({0, 1, 0}, 90, {-2.6, kHeight / 2, 0.3}));
  walls.add(wall_plane({4.6, kHeight}), turned({0, 1, 0}, -90, {2.6, kHeight / 2, 0.3}));
  walls.add(wall_plane({5.2, kHeight}), turned({0, 1, 0}, 180, {0, kHeight / 2, 2.6}));
  const double right = kDoorLeft + kDoorWide;
  const auto piece = [&](double x0, double x1, double y0, double y1) {  // of the wall with the door, 12 cm thick
    walls.add(box({x1 - x0, y1 - y0, 0.12}), at({(x0 + x1) / 2, (y0 + y1) / 2, kBack - 0.06}));
  };
  piece(-2.6, kDoorLeft, 0, kHeight);
  piece(right, 2.6, 0, kHeight);
  piece(kDoorLeft, right, kDoorHigh, kHeight);
  b.place("walls", walls, wall);

  // Behind it a corridor, 1.6 m deep. Its lamp hangs on the wall to the room, which sees but its light on the other.
  Polygons corridor;
  corridor.add(wall_plane({5.2, kHeight}), at({0, kHeight / 2, kBack - 1.72}));
  corridor.add(wall_plane({1.6, kHeight}), turned({0, 1, 0}, 90, {-2.6, kHeight / 2, kBack - 0.92}));
  corridor.add(wall_plane({1.6, kHeight}), turned({0, 1, 0}, -90, {2.6, kHeight / 2, kBack - 0.92}));
  corridor.add(floor_plane({5.2, 1.6}), turned({1, 0, 0}, 180, {0, kHeight, kBack - 0.92}));
  b.place("corridor", corridor, outside);
  b.lamp("lamp", {0.6, 1.0}, {2600, 2450, 2200}, {-2.19, 1.4, kBack - 0.14}, {0, 0, -1});

  // The frame of the door and its leaf, which opens into the corridor.
  Polygons frame;
  for (const double z : {0.008, -0.128}) {
    frame.add(box({0.09, kDoorHigh + 0.09, 0.016}, 1), at({kDoorLeft - 0.045, (kDoorHigh + 0.09) / 2, kBack + z}));
    frame.add(box({0.09, kDoorHigh + 0.09, 0.016}, 1), at({right + 0.045, (kDoorHigh + 0.09) / 2, kBack + z}));
    frame.add(box({kDoorWide, 0.09, 0.016}, 1), at({(kDoorLeft + right) / 2, kDoorHigh + 0.045, kBack + z}));
  }
  b.place("door_frame", frame, wood);
  const int hinge = b.group("hinge", {right, 0.004, kBack - 0.11});
  b.turn(hinge, [](double f) { return about_y(180 - 8 - 10.0 * (f - 1) / 23); });
  b.place("door", door_leaf(), wood, {}, {}, hinge);
  b.place("handle", handle(), brass, {kDoorWide - 0.07, 1.02, 0}, {}, hinge);

  // The table with the three teapots.
  Polygons desk = rounded_box({1.7, 0.04, 0.62}, 0.012, 3, 0.8);
  Polygons legs;
  const std::vector<Vec2d> profile{{0, 0},        {0.02, 0},     {0.026, 0.03}, {0.018, 0.08}, {0.030, 0.34},
                                   {0.022, 0.42}, {0.034, 0.47}, {0.034, 0.62}, {0, 0.62}};
  for (const double x : {-0.75, 0.75})
    for (const double z : {-0.24, 0.24}) legs.add(lathe(profile, 24, 60), at({x, 0, z}));
  b.place("desk", desk, table, {0.55, 0.64, -0.35}, about_y(-6));
  b.place("legs", legs, table, {0.55, 0, -0.35}, about_y(-6));
  const Vec3d top{0.55, 0.661, -0.35};
  const auto moving_pot = [&](const char* name, const Polygons& pot, int material, const Vec3d& from, const Vec3d& step,
                              double turn, double spin) {
    const int node = b.place(name, pot, material);
    b.move(node, [=](double f) { return top + from + step * (f - 1); });
    b.turn(node, [=](double f) { return about_y(turn + spin * (f - 1)); });
  };
  const Polygons solid = teapot(false, 0.005), hollow = teapot(true, 0.004);
  moving_pot("teapot_steel", solid, steel, {-0.52, 0, 0.05}, {0.006, 0, 0.001}, 20, 0);
  moving_pot("teapot_china", solid, china, {0.02, 0, -0.06}, {}, -25, 3);
  moving_pot("teapot_glass", hollow, glass, {0.56, 0, 0.06}, {-0.004, 0, 0}, 200, 1.5);

  b.place("painting", wall_plane({0.9, 0.6}), picture, {0.9, 1.62, kBack + 0.012});
  b.place("painting_frame", picture_frame({0.9, 0.6}, 0.06, 0.04), brass, {0.9, 1.62, kBack + 0.004});
  b.camera(36, {0.35, 1.28, 2.45}, {-0.02, 0.90, -1.0});
}

}  // namespace

extern const GalleryScene ajar_door_scene{
    .name = "ajar-door",
    .title = "A room with three teapots that gets its light through the slit of a door that opens",
    .paper = &kWoestijne2017,
    .figure = "Figure 8",
    .triangles = 91792,
    .shutter_close = 1,
    .spp = 128,
    .max_depth = 20,
    .reference_spp = 65536,
    .classes = {{"indirect", "ED.+", "diffuse surfaces in the light of others: nearly all there is"},
                {"mirrored", "ER.*", "what the floor and the teapot of steel reflect"},
                {"refracted", "ET.*", "what is seen through the teapot of glass"}},
    .moving = {"door", "teapot_steel", "teapot_china", "teapot_glass"},
    .variants = {{"98", "the 98 frames of the paper's animation", {{"frames", "\"1-98\""}}}},
    .about =
        "Veach's room, rebuilt from its description: the lamp stands in a corridor behind a door that is ajar, and a "
        "floor with a polish and\n"
        "two of three teapots are specular. The paper renders 24 frames with an ever open shutter, and 98 for its "
        "video, and does not state\n"
        "the motion. Here the door opens from 8 to 18 degrees in 24 frames (and on to 50 in 98), the teapots of steel "
        "and\n"
        "glass slide by 6 and 4 mm a frame, and those of china and glass turn by 3 and 1.5 degrees. The teapots are "
        "made by\n"
        "code, the glass one as a vessel with a wall of 7 mm.\n",
    .build = build,
};

}  // namespace tempera
