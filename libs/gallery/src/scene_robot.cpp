// SPDX-License-Identifier: Apache-2.0
// Stands for [Zimmer 2015, Figs. 1, 2, 4 to 7 and 9 to 13 (Robot)].
#include <algorithm>
#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

/// Printed shell: panels in two colors with lines, rivets and text. One texture for all parts of the body.
Picture decals() {
  return paint(1024, 1024, [](double u, double v) {
    const Rgb shell = hex("#dd7a1f"), light = hex("#efe9dc"), ink = hex("#23262b"), blue = hex("#2b6ca3");
    Rgb c = shell;
    const double x = u * 4, y = v * 4;
    const double fx = x - std::floor(x), fy = y - std::floor(y);
    if (fy > 0.62 && fy < 0.86) c = light;
    if (std::abs(fy - 0.60) < 0.012 || std::abs(fy - 0.88) < 0.012) c = ink;
    if (fy > 0.10 && fy < 0.14) c = blue;
    const double dot = std::hypot(std::fmod(fx * 8, 1.0) - 0.5, fy * 8 - 0.45);
    if (dot < 0.20) c = hex("#7d7f82");
    // Text in the light band, 96 dots across a quarter of the picture.
    const char* words[] = {"TMP-07  UNIT", "NO STEP  /24", "MIRA LABS  3", "LIGHT PATH +"};
    const char* text = words[std::size_t(int(x) + int(y)) % 4];
    if (text_coverage(text, (fx - 0.04) * 78, (fy - 0.66) * 44) > 0) c = ink;
    return c;
  });
}

void build(GalleryBuilder& b) {
  const Picture tiles = paint(512, 512, [](double u, double v) {
    const double x = u * 4, y = v * 4;
    const Brick t = brick(x, y, 1, 0);
    const double n = tiled_noise(u, v, 8, 5, 70);
    const Rgb stone = checker(x, y) ? mix(hex("#33414d"), hex("#4c5d6b"), 0.5 + 0.5 * n)
                                    : mix(hex("#d8d3c6"), hex("#b9b2a2"), 0.5 + 0.5 * n);
    return stone * float(0.5 + 0.5 * smooth_step(0.004, 0.016, t.from_joint));
  });
  const Picture paper = paint(256, 256, [](double u, double v) {
    const double x = std::fmod(u * 8, 1.0) - 0.5, y = std::fmod(v * 8, 1.0) - 0.5;
    const bool leaf = std::abs(x) < 0.16 * std::cos(kPiD * y) && std::abs(y) < 0.42;
    return leaf ? hex("#7f9486") : hex("#a3b3a4");
  });
  // Coats of index 1.5 over a base: dielectrics of roughness 0.
  const int body =
      b.material({.name = "plastic", .color = Rgb(1.0f), .texture = b.texture("decals", decals()), .roughness = 0});
  const int joint = b.material({.name = "joint", .color = hex("#2b2e33"), .roughness = 0});
  const int face = b.material({.name = "face", .color = hex("#efe9dc"), .roughness = 0});
  const int eye = b.material({.name = "eye", .color = hex("#0c1116"), .roughness = 0, .emission = {0.05f, 0.6f, 0.9f}});
  const int floor =
      b.material({.name = "floor", .color = Rgb(1.0f), .texture = b.texture("tiles", tiles), .roughness = 0});
  const int wall =
      b.material({.name = "wall", .color = Rgb(1.0f), .texture = b.texture("paper", paper), .specular = 0});
  const int white = b.material({.name = "white", .color = hex("#e2ded4"), .specular = 0});
  const int red = b.material({.name = "red", .color = hex("#a8402f"), .specular = 0});
  const int gold = b.material({.name = "gold", .color = {0.83f, 0.62f, 0.32f}, .roughness = 0.35, .metallic = 1});
  const int picture = b.material(
      {.name = "picture", .color = Rgb(1.0f), .texture = b.texture("picture", landscape(512, 384, 11)), .specular = 0});
  const int glass = b.glass("glass", 1.5);

  // Room 6 x 3 x 4 m; the front is open towards the dim environment behind the camera.
  b.place("floor", floor_plane({6, 5}, {6 / 2.4, 5 / 2.4}), floor, {0, 0, 0.5});
  b.place("ceiling", floor_plane({6, 4}), white, {0, 3, 0}, about_x(180));
  b.place("back_wall", wall_plane({6, 3}, {6 / 1.2, 3 / 1.2}), wall, {0, 1.5, -2});
  b.place("left_wall", wall_plane({4, 3}), red, {-3, 1.5, 0}, about_y(90));
  b.place("right_wall", wall_plane({4, 3}), white, {3, 1.5, 0}, about_y(-90));
  b.lamp("lamp", {1, 1}, {34, 31, 27}, {0.3, 2.98, 0.6}, {0, -1, 0});
  b.place("skirting", box({6, 0.12, 0.03}), white, {0, 0.06, -1.985});

  // Picture behind a pane of 4 mm.
  b.place("picture", wall_plane({1.0, 0.75}), picture, {0.95, 1.55, -1.985});
  b.place("pane", box({1.0, 0.75, 0.004}), glass, {0.95, 1.55, -1.975});
  b.place("frame", picture_frame({1.0, 0.75}, 0.07, 0.05), gold, {0.95, 1.55, -1.99});

  b.place("sphere", sphere(0.35, 128, 64), glass, {1.05, 0.351, -0.35});

  // The figure: eleven parts, each of one coated shell. It stands on x = -0.35 and faces the camera.
  const Vec3d stand{-0.45, 0, -0.55};
  const int root = b.group("robot", stand, about_y(14));
  const auto part = [&](const char* name, const Polygons& p, int material, const Vec3d& position, int parent,
                        const Quatd& turn = {}) { return b.place(name, p, material, position, turn, parent); };
  const auto shell = [](const Vec3d& size, double radius, const Vec2d& uv) {
    return rounded_box(size, radius, 6, 0.5).map_uv({1, 1}, uv);
  };
  part("torso", shell({0.56, 0.62, 0.36}, 0.09, {0.0, 0.0}), body, {0, 1.16, 0}, root);
  part("pelvis", shell({0.40, 0.20, 0.30}, 0.07, {0.3, 0.55}), body, {0, 0.75, 0}, root);
  for (const double s : {-1.0, 1.0}) {
    part(s < 0 ? "leg_right" : "leg_left",
         capsule({0, 0, 0}, {0, -0.46, 0}, 0.085, 0.075, 48).map_uv({1, 0.25}, {0.1, 0.25}), body, {s * 0.13, 0.62, 0},
         root);
    part(s < 0 ? "foot_right" : "foot_left", shell({0.19, 0.11, 0.32}, 0.05, {0.5, 0.5}), body, {s * 0.13, 0.056, 0.05},
         root);
  }
  // Head and right arm move.
  const int neck = b.group("neck", {0, 1.47, 0}, {}, root);
  b.turn(neck, [](double f) { return about_y(-15 + 30 * smooth_step(1, 48, f)); });
  part("neck_ring", cylinder(0.075, 0, 0.08, 48, 0.015), joint, {0, 0, 0}, neck);
  part("head", shell({0.42, 0.34, 0.34}, 0.11, {0.0, 0.3}), body, {0, 0.25, 0}, neck);
  part("visor", rounded_box({0.32, 0.15, 0.06}, 0.028, 5), face, {0, 0.26, 0.158}, neck);
  for (const double s : {-1.0, 1.0})
    part(s < 0 ? "eye_right" : "eye_left", sphere(0.032, 32, 16), eye, {s * 0.075, 0.26, 0.175}, neck);
  part("antenna", capsule({0, 0, 0}, {0, 0.12, 0}, 0.012, 0.012, 16), joint, {0.12, 0.42, 0}, neck);
  part("antenna_tip", sphere(0.03, 32, 16), face, {0.12, 0.56, 0}, neck);
  for (const double s : {-1.0, 1.0}) {
    const std::string side = s < 0 ? "right" : "left";
    const int shoulder = b.group("shoulder_" + side, {s * 0.33, 1.38, 0}, s > 0 ? about_z(8) : Quatd{}, root);
    part(("joint_" + side).c_str(), sphere(0.095, 48, 24), joint, {}, shoulder);
    part(("arm_" + side).c_str(),
         capsule({0, -0.06, 0}, {s * 0.05, -0.34, 0}, 0.065, 0.058, 48).map_uv({1, 0.25}, {0.6, 0.1}), body, {},
         shoulder);
    const int elbow = b.group("elbow_" + side, {s * 0.05, -0.40, 0}, s > 0 ? about_x(-25) : Quatd{}, shoulder);
    part(("elbow_joint_" + side).c_str(), sphere(0.062, 48, 24), joint, {}, elbow);
    part(("forearm_" + side).c_str(),
         capsule({0, -0.05, 0}, {0, -0.27, 0}, 0.055, 0.062, 48).map_uv({1, 0.25}, {0.35, 0.4}), body, {}, elbow);
    part(("hand_" + side).c_str(), sphere(0.075, 48, 24), joint, {0, -0.36, 0}, elbow);
    if (s < 0) {
      // It raises the arm by 60 degrees and waves.
      b.turn(shoulder, [](double f) { return about_z(-38 - 60 * smooth_step(1, 48, f)) * about_x(-12); });
      b.turn(elbow, [](double f) { return about_z(-42 - 22 * std::sin(f * 0.26)); });
    }
  }

  b.environment(Rgb(0.16f, 0.17f, 0.20f));
  // A dolly of 0.4 m.
  const auto eye_at = [](double f) { return Vec3d{0.55 - 0.4 * (f - 1) / 47, 1.35, 3.15}; };
  b.camera(34, eye_at, [](double f) { return Vec3d{0.2 - 0.12 * (f - 1) / 47, 0.98, -0.8}; });
}

}  // namespace

extern const GalleryScene robot_scene{
    .name = "robot",
    .title = "A robot of coated plastic waves beside a glass ball and a picture behind glass",
    .paper = &kZimmer2015,
    .figure = "Figures 1, 2, 4 to 7 and 9 to 13 (Robot)",
    .triangles = 49760,
    .last_frame = 48,
    .max_depth = 10,
    .reference_spp = 8192,
    .classes = {{"dd", "ED", "direct light on diffuse surfaces"},
                {"di", "ED.+", "their indirect light"},
                {"refl", "ERD.*", "reflections in plastic, floor, pane and ball"},
                {"trans", "ETTD.*", "the picture behind the pane, and the room through the ball"}},
    .decomposition = true,
    .camera_moves = true,
    .moving = {"arm_right", "forearm_right", "head", "visor"},
    .variants = {{"dof",
                  "depth of field: a lens with a radius of 6 cm, focused on the torso",
                  {{"cameras.camera.aperture_radius", "0.06"}, {"cameras.camera.focus_object", "\"torso\""}}},
                 {"sharp",
                  "a shutter that is open for no time, as keys of frames in between need",
                  {{"shutter.open", "0.25"}, {"shutter.close", "0.25"}}}},
    .about =
        "The paper's main scene: all five components of its decomposition (four classes and the residual) carry light. "
        "A figure of shells with a\n"
        "clear coat of index 1.5 over a printed base, a checkered floor with the same coat, a picture behind a pane of "
        "4 mm,\n"
        "a ball of glass of radius 0.35 m, a lamp of 1 x 1 m and a dim environment in a room of 6 x 3 x 4 m. In 48 "
        "frames the arm rises by 60\n"
        "degrees, the head turns by 30 and the camera goes 0.4 m sideways. The paper's picture has 1280 x 720 pixels "
        "at 512\n"
        "samples (16384 for its ground truth): `--resolution 1280x720 --spp 512`.\n",
    .build = build,
};

}  // namespace tempera
