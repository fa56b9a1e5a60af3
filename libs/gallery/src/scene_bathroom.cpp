// SPDX-License-Identifier: Apache-2.0
// Stands for [Woestijne 2017, Fig. 9].
#include "papers.h"
#include "published.h"

namespace tempera {

using namespace gallery;

namespace {

void build(GalleryBuilder& b) {
  // From the published camera (its position and direction) on a rail to the right and towards the basin.
  const Vec3d position{0.00724053, 0.912405, -0.227584}, forward = normalize(Vec3d{-0.751879, 0.015471, -0.659119}),
                                                         right = normalize(cross(forward, Vec3d{0, 1, 0}));
  const auto eye = [=](double f) {
    const double s = (f - 1) / 23;
    return position + right * (-0.12 + 0.30 * s) + forward * (0.12 * s);
  };
  include_published(b, 55, eye, [=](double f) { return position + forward * 1.6 + right * (0.05 * (f - 12) / 23); });
}

}  // namespace

extern const GalleryScene bathroom_scene{
    .name = "bathroom",
    .title = "A bathroom full of mirrors, taps and glass seen from a camera on a rail",
    .paper = &kWoestijne2017,
    .figure = "Figure 9",
    .triangles = 592188,
    .width = 512,
    .height = 512,
    .spp = 64,
    .max_depth = 16,
    .reference_spp = 16384,
    .classes = {{"direct", "ED", "direct light on diffuse surfaces"},
                {"mirrored", "ER.*", "what taps, mirrors and the frame reflect"},
                {"caustic", "ED[RT]+", "light by way of mirrors and glass"}},
    .camera_moves = true,
    .needs = "mitsuba/bathroom/scene.xml",
    .about =
        "The paper renders 24 frames of Mareck's \"Contemporary Bathroom\" (CC0, from Benedikt Bitterli's rendering "
        "resources) with a shutter that\n"
        "is open for half of the frame; it states no motion. Here the camera goes 0.3 m sideways and 0.12 m\n"
        "forwards. The scene file of the gallery includes the published one where it is, which is not copied.\n",
    .build = build,
};

}  // namespace tempera
