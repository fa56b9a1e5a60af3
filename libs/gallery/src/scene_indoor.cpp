// SPDX-License-Identifier: Apache-2.0
// Stands for [Zhou 2015, Fig. 5 and Table 1].
#include <fmt/format.h>

#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

// Room 6 x 4 m, 2.8 m high; x from -3 to 3, z from -2 to 2. The windows are in the wall at x = -3.
constexpr double kHeight = 2.8;

/// A chair with turned legs, its front towards +z, in about 2400 triangles.
Polygons chair() {
  Polygons out;
  const std::vector<Vec2d> leg{{0, 0},        {0.014, 0},    {0.017, 0.03}, {0.011, 0.06}, {0.019, 0.10}, {0.021, 0.20},
                               {0.013, 0.24}, {0.022, 0.27}, {0.013, 0.30}, {0.020, 0.34}, {0.022, 0.44}, {0, 0.44}};
  for (const double x : {-0.18, 0.18})
    for (const double z : {-0.18, 0.18}) out.add(lathe(leg, 18, 60), at({x, 0, z}));
  out.add(rounded_box({0.44, 0.035, 0.44}, 0.014, 2), at({0, 0.455, 0}));
  for (const double x : {-0.18, 0.18}) out.add(capsule({x, 0.46, -0.19}, {x * 1.06, 0.95, -0.25}, 0.016, 0.014, 10));
  out.add(rounded_box({0.42, 0.09, 0.025}, 0.01, 1), turned({1, 0, 0}, -7, {0, 0.92, -0.247}));
  out.add(rounded_box({0.38, 0.05, 0.02}, 0.008, 1), turned({1, 0, 0}, -7, {0, 0.70, -0.22}));
  for (const double x : {-0.09, 0.0, 0.09}) out.add(capsule({x, 0.70, -0.22}, {x, 0.90, -0.245}, 0.008, 0.008, 8));
  return out;
}

/// Sixty leaves on stems out of a pot, both sides visible.
Polygons leaves() {
  Polygons out;
  for (std::uint64_t k = 0; k < 60; ++k) {
    const auto r = [&](std::uint64_t purpose) { return random(77, k, purpose); };
    const double turn = 360 * (double(k) * 0.618 + 0.1 * r(0)), rise = 0.25 + 0.65 * r(1), reach = 0.10 + 0.22 * r(2),
                 size = 0.10 + 0.09 * r(3);
    const Polygons leaf = sheet(2, 4, [&](double u, double v) {
      const double wide = size * 0.36 * std::sin(kPiD * std::min(std::max(v, 0.0), 1.0)) + 0.001;
      const double x = (2 * u - 1) * wide;
      return Vec3d{x, rise + size * (0.5 * v - 0.7 * v * v) + 0.25 * std::abs(x), reach + size * v};
    });
    out.add(leaf, turned({0, 1, 0}, turn));
  }
  return out;
}

Polygons stems() {
  Polygons out;
  for (std::uint64_t k = 0; k < 60; k += 3) {
    const auto r = [&](std::uint64_t purpose) { return random(77, k, purpose); };
    const double turn = 360 * (double(k) * 0.618 + 0.1 * r(0)), rise = 0.25 + 0.65 * r(1), reach = 0.10 + 0.22 * r(2);
    out.add(tube(curve(std::vector<Vec3d>{{0, 0.1, 0.01}, {0, 0.6 * rise, 0.3 * reach}, {0, rise, reach}}, 2),
                 std::vector<double>{0.005}, 5, false),
            turned({0, 1, 0}, turn));
  }
  return out;
}

void build(GalleryBuilder& b) {
  const Picture checks = paint(256, 256, [](double u, double v) {
    const double x = u * 2, y = v * 2, n = tiled_noise(u, v, 8, 4, 12);
    const Brick t = brick(x, y, 1, 0);
    const Rgb tile = checker(x, y) ? mix(hex("#8c4b33"), hex("#74402c"), 0.5 + 0.5 * n)
                                   : mix(hex("#e2d5b9"), hex("#cdbd9c"), 0.5 + 0.5 * n);
    return tile * float(0.6 + 0.4 * smooth_step(0.005, 0.02, t.from_joint));
  });
  const Picture grain = paint(256, 256, [](double u, double v) {
    const double n = tiled_noise(u, v, 4, 5, 31);
    return mix(hex("#9c6b3f"), hex("#6d4424"), 0.5 + 0.3 * std::sin(2 * kPiD * (4 * u + n)) + 0.2 * n);
  });
  const int floor =
      b.material({.name = "floor", .color = Rgb(1.0f), .texture = b.texture("checks", checks), .roughness = 0.6});
  const int wood =
      b.material({.name = "wood", .color = Rgb(1.0f), .texture = b.texture("wood", grain), .roughness = 0.5});
  const int wall = b.material({.name = "wall", .color = hex("#d9cfb8"), .specular = 0});
  const int white = b.material({.name = "white", .color = hex("#ece8de"), .specular = 0});
  const int blue = b.material({.name = "blue", .color = hex("#3f6d8e"), .specular = 0});
  const int green = b.material({.name = "leaf", .color = hex("#3f7a34"), .roughness = 0.6});
  const int clay = b.material({.name = "clay", .color = hex("#b0593a"), .specular = 0});
  const int china = b.material({.name = "china", .color = hex("#dfe3e4"), .roughness = 0.3});
  const int apple = b.material({.name = "apple", .color = hex("#b8261f"), .roughness = 0.4});
  const int pear = b.material({.name = "pear", .color = hex("#b5a53a"), .roughness = 0.5});
  const int brass = b.material({.name = "brass", .color = {0.89f, 0.62f, 0.27f}, .roughness = 0.35, .metallic = 1});

  b.place("floor", floor_plane({6, 4}, {12, 8}), floor);
  b.place("ceiling", floor_plane({6, 4}), white, {0, kHeight, 0}, about_x(180));
  // Walls of 15 cm; openings of 0.9 x 1.4 m for the windows and 0.9 x 2.05 m for the door.
  Polygons walls;
  const auto along_z = [&](double x, double z0, double z1, double y0, double y1) {
    walls.add(box({0.15, y1 - y0, z1 - z0}), at({x, (y0 + y1) / 2, (z0 + z1) / 2}));
  };
  const auto along_x = [&](double z, double x0, double x1, double y0, double y1) {
    walls.add(box({x1 - x0, y1 - y0, 0.15}), at({(x0 + x1) / 2, (y0 + y1) / 2, z}));
  };
  const double left = -3.075, sill = 0.85, head = 2.25;
  along_z(left, -2.15, 2.15, 0, sill);
  along_z(left, -2.15, 2.15, head, kHeight);
  along_z(left, -2.15, -1.45, sill, head);
  along_z(left, -0.55, 0.35, sill, head);
  along_z(left, 1.25, 2.15, sill, head);
  along_z(3.075, -2.15, 2.15, 0, kHeight);
  along_x(2.075, -3.15, 3.15, 0, kHeight);
  along_x(-2.075, -3.15, 0.2, 0, kHeight);
  along_x(-2.075, 1.1, 3.15, 0, kHeight);
  along_x(-2.075, 0.2, 1.1, 2.05, kHeight);
  b.place("walls", walls, wall);
  Polygons frames;
  for (const double z : {-1.0, 0.8}) {
    frames.add(box({0.05, 1.4, 0.04}), at({left, 1.55, z}));
    frames.add(box({0.05, 0.04, 0.9}), at({left, 1.75, z}));
    frames.add(box({0.22, 0.03, 1.0}), at({left + 0.06, sill - 0.012, z}));
  }
  b.place("window_frames", frames, white);
  b.place("skirting", box({3.2, 0.1, 0.02}), white, {-1.4, 0.05, -1.99});
  // A passage behind the door, blue.
  Polygons passage = wall_plane({2.0, kHeight});
  b.place("passage", passage, blue, {0.65, kHeight / 2, -3.4});
  b.place("passage_floor", floor_plane({2.0, 1.3}), wood, {0.65, 0.001, -2.75});

  const int hinge = b.group("hinge", {0.22, 0, -2.0});
  b.turn(hinge, [](double f) { return about_y(-(20 + (f - 1))); });
  b.place("door", box({0.88, 2.03, 0.04}, 0.8), white, {0.44, 1.02, 0.0}, {}, hinge);
  b.place("knob", sphere(0.03, 20, 10), brass, {0.82, 1.02, 0.06}, {}, hinge);

  Polygons table = rounded_box({1.7, 0.04, 0.95}, 0.015, 2, 0.8);
  Polygons placed;
  placed.add(table, at({0, 0.74, 0}));
  for (const double x : {-0.75, 0.75})
    for (const double z : {-0.38, 0.38}) placed.add(rounded_box({0.06, 0.72, 0.06}, 0.012, 1), at({x, 0.36, z}));
  b.place("table", placed, wood, {-0.35, 0, -0.15}, about_y(8));
  const int seat = b.mesh("chair", chair(), wood);
  b.place("chair_1", seat, {-0.80, 0, 0.62}, about_y(172));
  b.place("chair_2", seat, {0.25, 0, 0.50}, about_y(205));
  b.place("chair_3", seat, {-0.75, 0, -0.85}, about_y(14));
  b.place("chair_4", seat, {0.90, 0, -0.55}, about_y(-70));

  const std::vector<Vec2d> bowl{{0, 0},       {0.07, 0},      {0.075, 0.012}, {0.12, 0.03},  {0.185, 0.085},
                                {0.20, 0.10}, {0.194, 0.104}, {0.175, 0.085}, {0.11, 0.036}, {0, 0.022}};
  const Vec3d bowl_at{-0.30, 0.762, -0.12};
  b.place("bowl", lathe(bowl, 40, 50), china, bowl_at);
  // Twelve spheres of 400 triangles in three layers.
  const int red = b.mesh("apple", sphere(0.05, 20, 11), apple), yellow = b.mesh("pear", sphere(0.047, 20, 11), pear);
  for (int k = 0; k < 12; ++k) {
    const int layer = k < 6 ? 0 : k < 11 ? 1 : 2;
    const double count = layer == 0 ? 6 : 5,
                 r = layer == 0   ? 0.105
                     : layer == 1 ? 0.062
                                  : 0,
                 a = 2 * kPiD * (k + 0.4 * layer) / count;
    b.place(fmt::format("fruit_{}", k), k % 3 == 1 ? yellow : red,
            bowl_at + Vec3d{r * std::cos(a), 0.095 + 0.072 * layer, r * std::sin(a)});
  }
  b.place("pot",
          lathe(
              std::vector<Vec2d>{
                  {0, 0}, {0.13, 0}, {0.17, 0.26}, {0.19, 0.27}, {0.19, 0.32}, {0.165, 0.32}, {0.16, 0.28}, {0, 0.27}},
              32),
          clay, {-2.45, 0, -1.45});
  b.place("leaves", leaves(), green, {-2.45, 0.22, -1.45});
  b.place("stems", stems(), green, {-2.45, 0.22, -1.45});
  const int picture = b.material(
      {.name = "picture", .color = Rgb(1.0f), .texture = b.texture("picture", landscape(256, 192, 5)), .specular = 0});
  b.place("picture", wall_plane({0.8, 0.6}), picture, {-1.0, 1.65, -1.985});
  b.place("picture_frame", picture_frame({0.8, 0.6}, 0.05, 0.03), wood, {-1.0, 1.65, -1.995});

  b.environment(sky(1024, {-0.75, 0.62, 0.32}, 3, 0.3, 26));
  b.camera(
      48,
      [](double f) {
        return Vec3d{1.75 - 0.0155 * (f - 1), 1.5, 1.80 - 0.0126 * (f - 1)};
      },
      [](double) {
        return Vec3d{-0.70, 0.80, -0.75};
      });
}

}  // namespace

extern const GalleryScene indoor_scene{
    .name = "indoor",
    .title = "A dining room lit through two windows, with a door that moves and thin things that touch",
    .paper = &kZhou2015,
    .figure = "Figure 5 and Table 1",
    .triangles = 19790,
    .width = 720,
    .height = 480,
    .spp = 32,
    .max_depth = 8,
    .reference_spp = 8192,
    .classes = {{"direct", "ED", "light of sky and sun that comes in"},
                {"indirect", "ED.+", "light that the room reflects"}},
    .camera_moves = true,
    .moving = {"door", "knob"},
    .about =
        "The test for blur: contact shadows of chairs, leaves and fruit, and a checkered floor of 0.25 m. Room of 6 x "
        "4 x 2.8 m with two windows\n"
        "of 0.9 x 1.4 m, four chairs with turned legs, a bowl with twelve spheres of 400 triangles, a plant of 60 "
        "leaves and a door that turns by\n"
        "1 degree a frame; about 19 000 triangles. The camera goes 0.02 m a frame. Sky and sun (3 degrees in radius,\n"
        "30 % of the irradiance) stand outside. 32 samples per pixel in the paper.\n",
    .build = build,
};

}  // namespace tempera
