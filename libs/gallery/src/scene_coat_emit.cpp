// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include "builder.h"

namespace tempera {

using namespace gallery;

namespace {

/// Letters that shine on a dim ground inside a line, and how much they do.
Picture sign_text() {
  return paint(384, 192, [](double u, double v) {
    const double x = u * 64, y = v * 32, edge = std::min(std::min(x, 64 - x), std::min(y, 32 - y));
    if (edge > 1.5 && edge < 2.5) return hex("#ff5a36");
    if (text_coverage("OPEN", x / 1.25 - 13.8, y / 1.25 - 4) > 0) return hex("#ffe9b0");
    if (text_coverage("24 HOURS", x - 8.5, y - 19) > 0) return hex("#58c7ff");
    return Rgb(0.01f);
  });
}

void build(GalleryBuilder& b) {
  const Picture tiles = paint(256, 256, [](double u, double v) {
    const double x = u * 8, y = v * 8;
    return checker(x, y) ? hex("#39424c") : hex("#b9b2a4");
  });
  const Picture stripes = paint(128, 128, [](double u, double v) {
    return std::fmod(u * 6 + v * 3, 1.0) < 0.35 ? hex("#efe6d2") : hex("#1f7a72");
  });
  const Picture plaster = paint(256, 256, [](double u, double v) {
    return mix(hex("#a59f93"), hex("#c4bdb1"), 0.5 + 0.5 * tiled_noise(u, v, 24, 4, 5));
  });
  // Coats of index 1.5 over a base, smooth: dielectrics of roughness 0.
  const int coated =
      b.material({.name = "coated", .color = Rgb(1.0f), .texture = b.texture("stripes", stripes), .roughness = 0});
  const int floor =
      b.material({.name = "floor", .color = Rgb(1.0f), .texture = b.texture("tiles", tiles), .roughness = 0});
  const int wall =
      b.material({.name = "wall", .color = Rgb(1.0f), .texture = b.texture("plaster", plaster), .specular = 0});
  const int sign = b.material({.name = "sign",
                               .color = hex("#101010"),
                               .specular = 0,
                               .emission = Rgb(4.0f),
                               .emission_texture = b.texture("sign", sign_text())});
  const int casing = b.material({.name = "casing", .color = hex("#2a2c30"), .specular = 0});
  // Silver at 630, 550 and 460 nm.
  const int mirror = b.material({.name = "mirror", .color = {0.97f, 0.96f, 0.91f}, .roughness = 0, .metallic = 1},
                                "type = \"conductor\"\neta = [0.135, 0.125, 0.144]\nk = [3.99, 3.34, 2.56]\n"
                                "roughness = 0.0\n");
  const int glass = b.glass("glass", 1.5);

  b.place("floor", floor_plane({7, 5}, {7 / 2.4, 5 / 2.4}), floor, {0, 0, 0.5});
  b.place("wall", wall_plane({7, 3}, {3.5, 1.5}), wall, {0, 1.5, -2});
  b.lamp("lamp", {0.8, 0.8}, {34, 32, 29}, {0.4, 2.9, 0.8}, {0, -1, 0});

  // The sign hangs before the wall, slides and swings; its back is dark, since light of glTF's materials leaves to both
  // sides.
  const Glb::Part parts[] = {{wall_plane({1.2, 0.6}), sign},
                             {Polygons().add(box({1.26, 0.66, 0.05}), at({0, 0, -0.027})), casing}};
  const int hung = b.glb().node({.name = "sign", .mesh = b.glb().mesh("sign", parts)});
  b.move(hung, [](double f) { return Vec3d{-0.55 + 0.35 * (f - 1) / 23, 1.2, -0.9}; });
  b.turn(hung, [](double f) { return about_y(10 + 0.7 * (f - 1)); });
  // Seen again in a mirror at the right, through a pane before it and a ball of glass, and in the coats.
  b.place("mirror", box({0.05, 1.5, 1.0}), mirror, {1.35, 0.85, -0.35}, about_y(23));
  const int pane = b.place("pane", box({0.45, 0.8, 0.06}), glass, {-0.7, 1.1, -0.2});
  b.move(pane, [](double f) { return Vec3d{-0.7 + 0.25 * (f - 1) / 23, 1.1, -0.2}; });
  b.turn(pane, [](double f) { return about_y(-25 + 1.2 * (f - 1)); });
  b.place("ball", sphere(0.25, 96, 48), glass, {0.42, 0.251, 0.25});
  const int block = b.place("block", rounded_box({0.55, 0.55, 0.55}, 0.06, 6, 1.5), coated, {-0.62, 0.276, -0.35});
  b.turn(block, [](double f) { return about_y(20 + 1.5 * (f - 1)); });
  b.place("column", lathe(std::vector<Vec2d>{{0, 0}, {0.2, 0}, {0.2, 0.5}, {0.14, 0.62}, {0, 0.66}}, 64), coated,
          {0.3, 0, -0.75});

  b.environment(Rgb(0.10f, 0.11f, 0.13f));
  b.camera(32, {0.05, 1.15, 3.3}, {0.12, 0.82, -0.6});
}

}  // namespace

extern const GalleryScene coat_emit_scene{
    .name = "coat-emit",
    .title = "A shining sign beside coated plastic, seen directly, in a mirror and through glass",
    .triangles = 11482,
    .max_depth = 10,
    .reference_spp = 4096,
    .classes = {{"emission", "E", "the sign as it is seen"},
                {"mirrored", "ER", "the sign and the lamp in the mirror and in coats"},
                {"passed", "ETT", "the sign through the pane and the ball"},
                {"dd", "ED", "direct light on diffuse surfaces and on the bases of coats"},
                {"di", "ED.+", "their indirect light"},
                {"refl", "ERD.*", "surfaces that the mirror and coats show"},
                {"trans", "ETTD.*", "surfaces through the pane and the ball"}},
    .decomposition = true,
    .moving = {"sign", "pane", "block"},
    .variants = {{"sharp",
                  "a shutter that is open for no time, as keys of frames in between need",
                  {{"shutter.open", "0.25"}, {"shutter.close", "0.25"}}}},
    .about =
        "A test of decompositions that has the light of emitters in classes of their own: what shines is seen directly "
        "(`E`), after a\n"
        "reflection (`ER`) and after two refractions (`ETT`), beside the light that it throws on coats and their "
        "bases. "
        "The sign goes 0.35 m\n"
        "sideways and swings by 16 degrees in 24 frames, a pane of 6 cm before it slides and turns, and a coated block "
        "turns. Its letters\n"
        "are a texture of its emission, so that vectors of what the mirror and the glass show are seen in them.\n",
    .build = build,
};

}  // namespace tempera
