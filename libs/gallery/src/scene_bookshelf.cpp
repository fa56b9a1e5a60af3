// SPDX-License-Identifier: Apache-2.0
// Stands for [Manzi 2016, Figs. 9 to 11 (Bookshelf)].
#include <fmt/format.h>

#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

// The shelf stands against the wall at z = 0: five boards of 2.6 m, 0.3 m deep and 0.36 m apart.
constexpr double kWidth = 2.6, kDepth = 0.30, kBoard = 0.025, kPitch = 0.36;
constexpr int kBoards = 5, kCloths = 6;

/// Spine of a book in one cloth: bands, and a title that runs down between them.
Picture spine(const char* cloth, const char* gilt, const char* title) {
  return paint(64, 256, [=](double u, double v) {
    const bool band = std::fmod(v + 0.02, 0.82) < 0.02 || std::abs(v - 0.2) < 0.008 || std::abs(v - 0.76) < 0.008;
    const bool letter = text_coverage(title, (v - 0.26) * 110, (0.68 - u) * 20) > 0;
    return (band || letter ? hex(gilt) : hex(cloth)) * float(0.9 + 0.1 * std::sin(2 * kPiD * 24 * (u + 4 * v)));
  });
}

void build(GalleryBuilder& b) {
  const char* const looks[kCloths][3] = {{"#7d1f1f", "#d9b45a", "RADIOSITY"}, {"#1f3a5f", "#d0c9a8", "OPTICS"},
                                         {"#2f4f33", "#d9b45a", "ANIMATION"}, {"#c8b184", "#5a2f1a", "GEOMETRY"},
                                         {"#3a2a24", "#c98f3f", "MEASURE"},   {"#d8d4c8", "#8a1f2a", "GRADIENTS"}};
  Polygons books[kCloths];
  std::uint64_t n = 0;
  for (int row = 0; row < kBoards; ++row) {
    // Rows end where something else stands; every tenth book leans against the one before.
    const double end = kWidth / 2 - (row % 2 ? 0.55 : 0.08);
    for (double x = -kWidth / 2 + 0.05; x < end - 0.1; ++n) {
      const auto r = [&](std::uint64_t purpose) { return random(41, n, purpose); };
      const Vec3d size{0.018 + 0.04 * r(0), 0.20 + 0.10 * r(1), 0.16 + 0.05 * r(2)};
      const bool leans = n % 10 == 9;
      const double tilt = leans ? 9 : 0, room = size.x + (leans ? 0.16 * size.y : 0.0);
      Polygons book = rounded_box(size, 0.003, 1);
      book.map_uv({1 / size.x, 1 / size.y});
      const Vec3d place{x + room / 2, 0.1 + kBoard + row * kPitch + size.y / 2, 0.26 - size.z / 2 - 0.02 * r(3)};
      books[std::size_t(kCloths * r(4))].add(book, turned({0, 0, 1}, tilt, place));
      x += room + 0.001 + (r(5) > 0.93 ? 0.06 : 0.0);
    }
  }
  for (int k = 0; k < kCloths; ++k) {
    const std::string name = fmt::format("cloth_{}", k);
    const int texture = b.texture(name, spine(looks[k][0], looks[k][1], looks[k][2]));
    b.place(fmt::format("books_{}", k), books[k],
            b.material({.name = name, .color = Rgb(1.0f), .texture = texture, .roughness = k % 2 ? 0.35 : 0.7}));
  }

  const Picture grain = paint(256, 256, [](double u, double v) {
    return mix(hex("#8a5a34"), hex("#5f3a1e"), 0.5 + 0.4 * std::sin(2 * kPiD * (5 * v + tiled_noise(u, v, 4, 4, 8))));
  });
  const int wood =
      b.material({.name = "wood", .color = Rgb(1.0f), .texture = b.texture("wood", grain), .roughness = 0.4});
  const int wall = b.material({.name = "wall", .color = hex("#d6ccb6"), .specular = 0});
  const int china = b.material({.name = "china", .color = hex("#4f7f9c"), .roughness = 0.2});
  const int brass = b.material({.name = "brass", .color = {0.89f, 0.62f, 0.27f}, .roughness = 0.3, .metallic = 1});
  Polygons shelf;
  for (int row = 0; row <= kBoards; ++row)
    shelf.add(box({kWidth, kBoard, kDepth}, 2), at({0, 0.1 + kBoard / 2 + row * kPitch, kDepth / 2}));
  const double height = 0.1 + kBoards * kPitch + kBoard;
  for (const double side : {-0.5, 0.0, 0.5})
    shelf.add(box({kBoard, height, kDepth}, 2), at({side * (kWidth + kBoard), height / 2, kDepth / 2}));
  b.place("shelf", shelf, wood);
  b.place("floor", floor_plane({6, 5}, {6, 5}), wood, {0, 0, 2.5});
  Polygons room = wall_plane({6, 2.8});
  room.add(wall_plane({6, 2.8}), turned({0, 1, 0}, 180, {0, 0, 5}));
  for (const double side : {-1.0, 1.0})
    room.add(wall_plane({5, 2.8}), turned({0, 1, 0}, -90 * side, {3 * side, 0, 2.5}));
  room.add(floor_plane({6, 5}), turned({1, 0, 0}, 180, {0, 1.4, 2.5}));
  b.place("room", room, wall, {0, 1.4, 0});

  const std::vector<Vec2d> vase{{0, 0},       {0.05, 0},     {0.09, 0.06}, {0.095, 0.12}, {0.04, 0.2},
                                {0.05, 0.25}, {0.044, 0.25}, {0.03, 0.2},  {0, 0.19}};
  b.place("vase", lathe(curve(vase, 3), 40, 60), china, {1.0, 0.1 + kBoard + 3 * kPitch, 0.15});
  const double radius = 0.07;
  const int ball = b.place("ball", sphere(radius, 40, 20), brass);
  b.move(ball, [=](double f) { return Vec3d{1.2 - 0.012 * f, 0.1 + kBoard + kPitch + radius, 0.18}; });
  b.turn(ball, [=](double f) { return about_z(0.012 * f / radius * 180 / kPiD); });

  b.lamp("ceiling_lamp", {1.2, 0.5}, {42, 37, 31}, {-0.5, 2.75, 2.1}, {0, -1, 0});
  b.camera(
      34,
      [](double f) {
        return Vec3d{-0.35 + 0.014 * f, 1.12, 2.6 - 0.004 * f};
      },
      [](double f) {
        return Vec3d{-0.1 + 0.009 * f, 0.98, 0.15};
      });
}

}  // namespace

extern const GalleryScene bookshelf_scene{
    .name = "bookshelf",
    .title = "Books, a vase and a rolling ball on a shelf that the camera goes along",
    .paper = &kManzi2016,
    .figure = "Figures 9 to 11 (Bookshelf)",
    .triangles = 29188,
    .last_frame = 48,
    .spp = 32,
    .max_depth = 7,
    .reference_spp = 8192,
    .classes = {{"direct", "ED", "direct light"}, {"indirect", "ED.+", "light by more than one reflection"}},
    .camera_moves = true,
    .moving = {"ball"},
    .about =
        "Fine texture, thin gaps and gloss, which all move against the pixels: the camera goes 14 mm a frame, and a "
        "ball of brass rolls\n"
        "12 mm the other way. The paper's shelf cannot be had; titles, shelf and room are ours. It rendered 32 samples "
        "per pixel with its\n"
        "method against 80 of path tracing.\n",
    .build = build,
};

}  // namespace tempera
