// SPDX-License-Identifier: Apache-2.0
// Stands for [Schjoth 2010, Figs. 7 and 8].
#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

// Scene C of the photon study, with y up: its z is our y, its y our -z.
constexpr double kRadius = 0.2, kLength = 2.4, kLevel = 0.4, kDegrees = 5;  // metres; degrees per frame
constexpr double kSunRadius = 2;                                            // degrees

void fill(GalleryBuilder& b, bool collimated) {
  const int floor =
      b.material({.name = "floor", .color = Rgb(0.8f), .specular = 0}, "type = \"diffuse\"\nreflectance = 0.8\n");
  const int post = b.material({.name = "post", .color = {0.16f, 0.11f, 0.07f}, .roughness = 0.5});
  const int glass = b.glass("glass", 1.5);
  b.place("floor", floor_plane({24, 24}), floor);
  b.place("post", cylinder(0.05, 0, 0.195, 32, 0.01), post);
  // 128 quadrilaterals around and 48 along; the ends are flat.
  std::vector<Vec2d> profile{{0, 0}};
  for (int k = 0; k <= 48; ++k) profile.push_back({kRadius, kLength * k / 48});
  profile.push_back({0, kLength});
  const int pivot = b.group("pivot", {0, kLevel, 0});
  b.turn(pivot, [](double f) { return about_y(kDegrees * f); });
  b.place("rod", lathe(profile, 128), glass, {}, about_z(-90), pivot);
  if (collimated) {
    const int light = b.glb().directional_light("collimated", Rgb(kPi));
    b.glb().node({.name = "collimated", .translation = {0, 5, 0}, .rotation = about_x(-90), .light = light});
  }
  b.camera(34, {0.85, 3.3, 2.5}, {0.72, 0, -0.95});
  b.camera_above("above", {1.2, 0.15, 0}, {2.8, 2.4});
}

void build(GalleryBuilder& b) {
  fill(b, false);
  b.start_file("scene_collimated.glb");
  fill(b, true);
  b.exposure(-1.5);
  b.environment(sky(512, {0, 1, 0}, kSunRadius, 0.9, kPiD / 0.9, {0.30f, 0.42f, 0.62f}, {0.62f, 0.66f, 0.70f},
                    {0.2f, 0.2f, 0.2f}, Rgb(1.0f)));
}

}  // namespace

extern const GalleryScene glass_cylinder_scene{
    .name = "glass-cylinder",
    .title = "A rod of glass turns about one of its ends in light from straight above",
    .paper = &kSchjoth2010,
    .figure = "Figures 7 and 8",
    .triangles = 13186,
    .shutter_close = 1,
    .spp = 128,
    .max_depth = 12,
    .reference_spp = 16384,
    .classes = {{"caustic", "ED[RT]+", "light that the rod focuses onto the floor"},
                {"direct", "ED", "the floor beside it"}},
    .moving = {"rod"},
    .variants = {{"collimated",
                  "exactly collimated light: `path` cannot find its caustic, methods that start at the light can",
                  {{"scene", "\"scene_collimated.glb\""},
                   {"environment.image", ""},
                   {"environment.radiance", "[0.04, 0.05, 0.065]"}}}},
    .about =
        "A solid rod (radius 0.2, length 2.4, index 1.5) lies at height 0.4 with one end on the vertical axis and "
        "turns about it by 5 degrees\n"
        "a frame, counterclockwise from above; at frame 0 it points along +x. Its free end is fast and its caustic "
        "there blurred. 128 x 48\n"
        "quadrilaterals with exact normals, and flat ends. The exposure is the whole frame; the floor has reflectance "
        "0.8. The camera `above` looks straight down on the floor from below the rod.\n\n"
        "As in `wave`, a sun (2 degrees in radius, 0.9 of the irradiance, which is pi without the sky) stands for "
        "collimated light,\n"
        "and the variant `collimated` has the paper's.\n",
    .build = build,
};

}  // namespace tempera
