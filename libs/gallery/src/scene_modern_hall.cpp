// SPDX-License-Identifier: Apache-2.0
// Stands for [Manzi 2016, Figs. 1, 7, 10 and 11 (in place of Kitchen 1 and 2)].
#include "papers.h"
#include "published.h"

namespace tempera {

using namespace gallery;

namespace {

void build(GalleryBuilder& b) {
  const Vec3d position{6.91182, 1.65163, 2.55414}, forward = normalize(Vec3d{-0.900177, 0, -0.435523}),
                                                   right = normalize(cross(forward, Vec3d{0, 1, 0}));
  const auto eye = [=](double f) {
    const double s = (f - 1) / 47;
    return position + forward * (0.9 * s) + right * (0.35 * s);
  };
  b.exposure(-1.5);
  include_published(b, 70, eye, [=](double f) { return position + forward * 6.0 + right * (-0.5 * (f - 1) / 47); });
}

}  // namespace

extern const GalleryScene modern_hall_scene{
    .name = "modern-hall",
    .title = "A furnished hall with many lamps, glass and a polished floor, seen from a camera that walks in",
    .paper = &kManzi2016,
    .figure = "Figures 1, 7, 10 and 11 (in place of Kitchen 1 and 2)",
    .triangles = 30927,
    .last_frame = 48,
    .spp = 64,
    .max_depth = 8,
    .reference_spp = 8192,
    .classes = {{"direct", "ED", "direct light on diffuse surfaces"},
                {"indirect", "ED.+", "their indirect light"},
                {"mirrored", "ER.*", "reflections"}},
    .camera_moves = true,
    .needs = "mitsuba/modern-hall/scene_v3.xml",
    .about =
        "The paper's kitchens cannot be had. This interior by NewSee2l035 (\"Modern Hall\", CC BY 3.0, from Benedikt "
        "Bitterli's rendering\n"
        "resources) has what they were chosen for: glossy surfaces, many lamps and a moving camera. The paper rendered "
        "them\n"
        "with 256 samples per pixel, 640 for path tracing. The camera walks 0.9 m in 48 frames and turns a\n"
        "little. The scene file of the gallery includes the published one where it is, which is not copied.\n",
    .build = build,
};

}  // namespace tempera
