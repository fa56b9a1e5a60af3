// SPDX-License-Identifier: Apache-2.0
// Stands for [Manzi 2016, Fig. 11 (Sponza)].
#include <fmt/format.h>

#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

// A courtyard between two arcades on two floors; x along it, z across. Bays of 3 m.
constexpr double kBay = 3.0, kHalf = 3.4, kAisle = 3.2, kLower = 4.4, kUpper = 3.6;
constexpr int kBays = 8;
constexpr double kLength = kBays * kBay;

/// Wall of one bay with a round arch, in the x-y plane, its springing at y = 0.
Polygons arch(double width, double opening, double height, double depth) {
  std::vector<Vec2d> outline{{-width / 2, 0}, {-opening / 2, 0}};
  constexpr int kSteps = 20;
  for (int k = 1; k < kSteps; ++k) {
    const double a = kPiD * (1 - double(k) / kSteps);
    outline.push_back({opening / 2 * std::cos(a), opening / 2 * std::sin(a)});
  }
  outline.insert(outline.end(), {{opening / 2, 0}, {width / 2, 0}, {width / 2, height}, {-width / 2, height}});
  Polygons out = extrude(outline, depth, 0.5, 20);
  // A moulding around the arch, on both faces.
  std::vector<Vec3d> ring;
  for (int k = 0; k <= kSteps; ++k) {
    const double a = kPiD * (1 - double(k) / kSteps), r = opening / 2 + 0.10;
    ring.push_back({r * std::cos(a), r * std::sin(a), 0});
  }
  const Polygons moulding = tube(ring, std::vector<double>{0.05}, 8, false);
  for (const double side : {-1.0, 1.0}) out.add(moulding, at({0, 0, side * depth / 2}));
  return out;
}

/// Column with base and capital from y = 0 to `height`.
Polygons column(double radius, double height) {
  const double r = radius, h = height;
  const std::vector<Vec2d> shaft{{0, 0.14},
                                 {1.28 * r, 0.14},
                                 {1.34 * r, 0.18},
                                 {1.28 * r, 0.22},
                                 {1.12 * r, 0.25},
                                 {1.20 * r, 0.29},
                                 {1.04 * r, 0.34},
                                 {1.0 * r, 0.42},
                                 {0.98 * r, 0.5 * h},
                                 {0.86 * r, h - 0.52},
                                 {0.96 * r, h - 0.50},
                                 {0.96 * r, h - 0.46},
                                 {0.88 * r, h - 0.44},
                                 {0.92 * r, h - 0.34},
                                 {1.20 * r, h - 0.20},
                                 {1.42 * r, h - 0.12},
                                 {0, h - 0.12}};
  Polygons out = lathe(shaft, 32, 40);
  out.map_uv({2, 3});
  out.add(rounded_box({2.9 * r, 0.14, 2.9 * r}, 0.02, 1, 0.5), at({0, 0.07, 0}));
  out.add(rounded_box({3.0 * r, 0.12, 3.0 * r}, 0.02, 1, 0.5), at({0, h - 0.06, 0}));
  return out;
}

/// Cloth that hangs from a pole in folds, `size` wide and high, its upper edge at y = 0.
Polygons banner(const Vec2d& size, double phase) {
  return sheet(32, 24, [=](double u, double v) {
    const double down = 1 - v, x = (u - 0.5) * size.x;
    const double folds =
        0.06 * (0.35 + 0.65 * down) * std::sin(4.5 * kPiD * u + phase + 0.8 * std::sin(2 * down + phase)) +
        0.05 * down * std::sin(kPiD * u + phase);
    return Vec3d{x * (1 - 0.05 * std::sin(kPiD * down)), -down * size.y + 0.07 * std::cos(2 * kPiD * u) * down, folds};
  });
}

Polygons urn() {
  return lathe(curve(std::vector<Vec2d>{{0, 0},
                                        {0.16, 0},
                                        {0.17, 0.04},
                                        {0.08, 0.10},
                                        {0.07, 0.16},
                                        {0.24, 0.36},
                                        {0.30, 0.56},
                                        {0.24, 0.72},
                                        {0.20, 0.78},
                                        {0.27, 0.86},
                                        {0.26, 0.88},
                                        {0.19, 0.80},
                                        {0.10, 0.70},
                                        {0, 0.66}},
                     2),
               24, 50);
}

void build(GalleryBuilder& b) {
  const Picture ashlar = paint(512, 512, [](double u, double v) {
    const Brick t = brick(u * 3, v * 3, 0.5, 0.5);
    const double tone = random(15, std::uint64_t(((t.row % 6) + 6) % 6), std::uint64_t(((t.column % 3) + 3) % 3)),
                 n = tiled_noise(u, v, 12, 6, 83);
    const Rgb stone = mix(hex("#c9b18a"), hex("#a98d68"), tone) * float(1 + 0.16 * n);
    return mix(hex("#7c694f"), stone, smooth_step(0.006, 0.022, t.from_joint + 0.008 * n));
  });
  const Picture flags = paint(512, 512, [](double u, double v) {
    const double x = u * 4, y = v * 4, n = tiled_noise(u, v, 10, 6, 19);
    const Brick t = brick(x, y, 1, 0);
    const bool dark = checker(x, y) != 0, star = std::abs(t.u - 0.5) + std::abs(t.v - 0.5) < 0.22;
    const Rgb stone = mix(dark != star ? hex("#8a6f56") : hex("#cbbb9f"), hex("#9a8668"), 0.3 + 0.4 * n);
    return stone * float(0.5 + 0.5 * smooth_step(0.006, 0.02, t.from_joint));
  });
  const auto weave = [&](const char* name, const char* base, const char* motif) {
    return b.texture(name, paint(256, 384, [=](double u, double v) {
                       const double x = std::fmod(u * 4, 1.0) - 0.5, y = std::fmod(v * 6, 1.0) - 0.5;
                       const double r = std::hypot(x, y), a = std::atan2(y, x);
                       const bool figure = r < 0.26 + 0.08 * std::cos(4 * a) && r > 0.12;
                       const bool edge = u < 0.05 || u > 0.95 || v > 0.95;
                       return (figure || edge ? hex(motif) : hex(base)) *
                              float(0.92 + 0.08 * std::sin(2 * kPiD * 90 * u) * std::sin(2 * kPiD * 135 * v));
                     }));
  };
  const int wall_texture = b.texture("ashlar", ashlar);
  const int stone = b.material({.name = "ashlar", .color = Rgb(1.0f), .texture = wall_texture, .specular = 0});
  const int smooth = b.material({.name = "column", .color = hex("#cdbb9b"), .roughness = 0.8});
  const int floor =
      b.material({.name = "flags", .color = Rgb(1.0f), .texture = b.texture("flags", flags), .roughness = 0.5});
  const int plaster = b.material({.name = "plaster", .color = hex("#c9a877"), .specular = 0});
  const int roof = b.material({.name = "roof", .color = hex("#a4552f"), .specular = 0});
  const int iron = b.material({.name = "iron", .color = hex("#2a2622"), .roughness = 0.6});
  const int clay = b.material({.name = "urn", .color = hex("#9c8468"), .specular = 0});
  const int cloth[3] = {b.material({.name = "cloth_red",
                                    .color = Rgb(1.0f),
                                    .texture = weave("cloth_red", "#8f1f22", "#d8a441"),
                                    .specular = 0}),
                        b.material({.name = "cloth_green",
                                    .color = Rgb(1.0f),
                                    .texture = weave("cloth_green", "#1f5b3a", "#d0b04c"),
                                    .specular = 0}),
                        b.material({.name = "cloth_blue",
                                    .color = Rgb(1.0f),
                                    .texture = weave("cloth_blue", "#234a86", "#d9c27a"),
                                    .specular = 0})};

  const double outer = kHalf + kAisle, top = kLower + kUpper;
  b.place("floor", floor_plane({kLength + 2 * kAisle, 2 * outer}, {(kLength + 2 * kAisle) / 2.4, 2 * outer / 2.4}),
          floor);
  const int lower_column = b.mesh("lower_column", column(0.26, 2.75), smooth),
            upper_column = b.mesh("upper_column", column(0.15, 1.55), smooth);
  const int lower_arch = b.mesh("lower_arch", arch(kBay, 2.3, kLower - 2.75, 0.55), stone),
            upper_arch = b.mesh("upper_arch", arch(kBay / 2, 1.05, kUpper - 2.45, 0.42), stone);
  const int post = b.mesh("post", rounded_box({0.5, 0.9, 0.5}, 0.02, 1, 0.5), stone);
  const int parapet = b.mesh("parapet", box({kBay, 0.9, 0.3}, 0.5), stone);
  const int slab = b.mesh("slab", box({kBay, 0.3, kAisle + 0.3}, 0.5), plaster);
  const int cornice = b.mesh(
      "cornice",
      extrude(std::vector<Vec2d>{{-0.21, 0}, {0.21, 0}, {0.36, 0.14}, {0.40, 0.24}, {-0.21, 0.24}}, kBay, 0.5), smooth);

  for (const double side : {-1.0, 1.0}) {
    for (int k = 0; k < kBays; ++k) {
      const double x = (k + 0.5) * kBay - kLength / 2, z = side * kHalf;
      const std::string id = std::string(side < 0 ? "_n" : "_s") + std::to_string(k);
      const Quatd turn = about_y(side < 0 ? 0 : 180);  // faces the courtyard
      b.place("lower_column" + id, lower_column, {x - kBay / 2, 0, z});
      b.place("lower_arch" + id, lower_arch, {x, 2.75, z}, turn);
      b.place("slab" + id, slab, {x, kLower - 0.15, side * (kHalf + kAisle / 2)});
      b.place("cornice" + id, cornice, {x, kLower, z - side * 0.10}, turn * about_y(-90));
      b.place("parapet" + id, parapet, {x, kLower + 0.45, z});
      for (const double half : {-0.25, 0.25}) {
        const std::string which = id + (half < 0 ? "a" : "b");
        b.place("upper_column" + which, upper_column, {x + (half - 0.25) * kBay, kLower + 0.9, z});
        b.place("upper_arch" + which, upper_arch, {x + half * kBay, kLower + 2.45, z}, turn);
      }
      b.place("roof" + id, slab, {x, top + 0.15, side * (kHalf + kAisle / 2)});
      b.place("eaves" + id, cornice, {x, top, z - side * 0.05}, turn * about_y(-90));
    }
    b.place(side < 0 ? "last_column_n" : "last_column_s", lower_column, {kLength / 2, 0, side * kHalf});
    b.place(side < 0 ? "last_upper_n" : "last_upper_s", upper_column, {kLength / 2, kLower + 0.9, side * kHalf});
    b.place(side < 0 ? "back_wall_n" : "back_wall_s",
            wall_plane({kLength + 2 * kAisle, top + 0.3}, {(kLength + 2 * kAisle) / 2, (top + 0.3) / 2}), stone,
            {0, (top + 0.3) / 2, side * outer}, about_y(side < 0 ? 0 : 180));
    // The ends: a wall with one wide arch below and a gallery above.
    const double end = side * kLength / 2;
    const Quatd turn = about_y(side < 0 ? 90 : -90);
    const std::string id = side < 0 ? "_w" : "_e";
    b.place("end_wall" + id, wall_plane({2 * outer, top + 0.3}, {outer, (top + 0.3) / 2}), stone,
            {side * (kLength / 2 + kAisle), (top + 0.3) / 2, 0}, turn);
    for (const double z : {-kHalf / 2 - 0.1, kHalf / 2 + 0.1}) {
      b.place("end_arch" + id + (z < 0 ? "a" : "b"), arch(kHalf + 0.2, 2.5, kLower - 2.75, 0.55), stone, {end, 2.75, z},
              turn);
      b.place("end_parapet" + id + (z < 0 ? "a" : "b"), box({kHalf, 0.9, 0.3}, 0.5), stone, {end, kLower + 0.45, z},
              turn);
    }
    b.place("end_column" + id, lower_column, {end, 0, 0});
    b.place("end_slab" + id, box({kAisle + 0.3, 0.3, 2 * outer}, 0.5), plaster,
            {side * (kLength / 2 + kAisle / 2), kLower - 0.15, 0});
    b.place("end_roof" + id, box({kAisle + 0.3, 0.3, 2 * outer}, 0.5), roof,
            {side * (kLength / 2 + kAisle / 2), top + 0.15, 0});
    for (const double z : {-kHalf, kHalf})
      b.place("corner_post" + id + (z < 0 ? "a" : "b"), post, {end, kLower + 0.45, z});
  }

  // Banners between the columns of the gallery, on iron poles, and urns in the courtyard.
  int n = 0;
  for (int k = 1; k < kBays; ++k) {
    for (const double side : {-1.0, 1.0}) {
      if ((k + (side > 0)) % 2 == 0) continue;
      const double x = k * kBay - kLength / 2;
      const std::string id = fmt::format("_{}", n);
      b.place("banner" + id, banner({1.7, 2.5}, 1.7 * n), cloth[n % 3], {x, kLower + 0.75, side * (kHalf - 0.42)},
              about_y(side < 0 ? 0 : 180));
      b.place("pole" + id, capsule({-0.95, 0, 0}, {0.95, 0, 0}, 0.025, 0.025, 12), iron,
              {x, kLower + 0.79, side * (kHalf - 0.42)});
      ++n;
    }
  }
  const int pot = b.mesh("urn", urn(), clay);
  for (int k = 0; k < 4; ++k)
    for (const double side : {-1.0, 1.0})
      b.place(fmt::format("urn_{}{}", k, side < 0 ? "n" : "s"), pot, {(k - 1.5) * 2 * kBay, 0, side * (kHalf - 0.75)});
  b.place("fountain",
          lathe(std::vector<Vec2d>{{0, 0},
                                   {1.1, 0},
                                   {1.12, 0.42},
                                   {1.2, 0.46},
                                   {1.2, 0.52},
                                   {1.0, 0.52},
                                   {0.98, 0.3},
                                   {0.2, 0.28},
                                   {0.12, 0.9},
                                   {0.5, 1.1},
                                   {0.52, 1.14},
                                   {0.1, 1.08},
                                   {0.06, 1.3},
                                   {0, 1.32}},
                64, 40),
          smooth, {1.5, 0, 0});

  b.environment(sky(1024, {0.42, 0.80, 0.30}, 1.5, 0.6, 7.5));
  // A flight along the arcade and down into the courtyard.
  const std::vector<Vec3d> eyes = curve(
      std::vector<Vec3d>{
          {-10.6, 2.9, 1.2}, {-9.2, 2.5, 0.75}, {-7.6, 2.1, 0.2}, {-5.9, 1.8, -0.45}, {-4.1, 1.65, -1.0}},
      32);
  const std::vector<Vec3d> targets =
      curve(std::vector<Vec3d>{{2, 2.5, -1.6}, {3, 2.6, -1.5}, {4.5, 2.7, -1.0}, {6, 2.8, -0.4}, {7.5, 2.8, 0.2}}, 32);
  const auto sample = [](const std::vector<Vec3d>& line, double f) {
    const double s = std::min(std::max(f / 50, 0.0), 1.0) * double(line.size() - 1);
    const std::size_t i = std::min(std::size_t(s), line.size() - 2);
    return line[i] + (line[i + 1] - line[i]) * (s - double(i));
  };
  b.camera(
      48, [&](double f) { return sample(eyes, f); }, [&](double f) { return sample(targets, f); });
}

}  // namespace

extern const GalleryScene sponza_scene{
    .name = "sponza",
    .title = "A flight through a courtyard with arcades on two floors, banners and a sun",
    .paper = &kManzi2016,
    .figure = "Figure 11 (Sponza)",
    .triangles = 128298,
    .last_frame = 48,
    .spp = 32,
    .max_depth = 7,
    .reference_spp = 8192,
    .classes = {{"direct", "ED", "direct light of sky and sun"},
                {"indirect", "ED.+", "light by more than one reflection"}},
    .camera_moves = true,
    .about =
        "Architecture in the manner of the model that the paper flew through, generated: eight bays of 3 m with round "
        "arches on columns, a\n"
        "gallery with arches of half the width, a roof around the open courtyard. Most of the light below the arcades "
        "is indirect. The paper\n"
        "used 32 samples per pixel with its method and 80 for path tracing.\n",
    .build = build,
};

}  // namespace tempera
