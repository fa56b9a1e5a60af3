// SPDX-License-Identifier: Apache-2.0
// Stands for [Zhou 2015, Fig. 4 and Table 1].
#include <algorithm>
#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

constexpr double kWheel = 0.78, kDrive = 0.05;  // radius, metres; metres per frame
constexpr double kFront = 1.55, kRear = -1.65, kTrack = 0.95;

/// A tyre with lugs and its rim, axis along z, in about 8000 triangles.
Polygons tyre() {
  Polygons out;
  const std::vector<Vec2d> carcass{{0.42, -0.26},  {0.50, -0.30}, {0.66, -0.30}, {0.72, -0.27},
                                   {0.735, -0.15}, {0.735, 0.15}, {0.72, 0.27},  {0.66, 0.30},
                                   {0.50, 0.30},   {0.42, 0.26},  {0.42, -0.26}};
  out.add(lathe(curve(carcass, 2), 60, 80), turned({1, 0, 0}, 90));
  constexpr int kLugs = 20;
  const Polygons lug = rounded_box({0.075, 0.10, 0.33}, 0.014, 1);
  for (int k = 0; k < kLugs; ++k) {
    for (const double side : {-1.0, 1.0}) {
      const double turn = 360.0 * (k + (side > 0 ? 0.5 : 0)) / kLugs;
      out.add(lug, turned({0, 0, 1}, turn) * turned({0, 1, 0}, side * 32, {kWheel - 0.05, 0, side * 0.15}));
    }
  }
  return out;
}

Polygons rim() {
  const std::vector<Vec2d> profile{{0, -0.10},    {0.10, -0.10}, {0.13, -0.04}, {0.22, -0.02},
                                   {0.32, -0.10}, {0.36, -0.20}, {0.42, -0.24}, {0.43, -0.22},
                                   {0.43, 0.22},  {0.42, 0.24},  {0.36, 0.20},  {0.32, 0.10},
                                   {0.22, 0.02},  {0.13, 0.04},  {0.10, 0.10},  {0, 0.10}};
  Polygons out;
  out.add(lathe(profile, 32, 40), turned({1, 0, 0}, 90));
  const Polygons bolt = cylinder(0.018, 0, 0.03, 6);
  for (int k = 0; k < 10; ++k) {
    const double a = 2 * kPiD * k / 10;
    for (const double side : {-1.0, 1.0})
      out.add(bolt, turned({1, 0, 0}, side * 90, {0.17 * std::cos(a), 0.17 * std::sin(a), side * 0.03}));
  }
  return out;
}

/// Bucket: its pivot at the origin, the mouth towards +x at angle 0, 2.5 m wide.
Polygons bucket() {
  constexpr double kHalf = 1.25, kPlate = 0.025;
  // The shell's section, from the upper lip around the back to the cutting edge.
  const std::vector<Vec2d> points{{0.36, 0.66},  {0.10, 0.58},  {-0.06, 0.36}, {-0.10, 0.06},
                                  {0.02, -0.20}, {0.26, -0.34}, {0.62, -0.38}, {1.02, -0.39}};
  const std::vector<Vec2d> section = curve(points, 8);
  std::vector<Vec2d> outline(section.rbegin(), section.rend());
  for (std::size_t i = 0; i < section.size(); ++i) {
    const Vec2d a = section[i > 0 ? i - 1 : 0], b = section[std::min(i + 1, section.size() - 1)], d = b - a;
    outline.push_back(section[i] + Vec2d{-d.y, d.x} * (kPlate / length(d)));
  }
  std::reverse(outline.begin(), outline.end());  // counterclockwise seen from +z
  Polygons out = extrude(outline, 2 * kHalf, 0.5, 40);
  // The sides: the section closed from lip to edge.
  std::vector<Vec2d> side(section.begin(), section.end());
  for (const double z : {-kHalf, kHalf}) out.add(extrude(side, 0.03, 0.5, 40), at({0, 0, z}));
  const Polygons tooth = rounded_box({0.24, 0.05, 0.11}, 0.018, 2);
  for (int k = 0; k < 9; ++k)
    out.add(tooth, turned({0, 0, 1}, -4, {1.08, -0.385, -kHalf + 0.14 + k * (2 * kHalf - 0.28) / 8}));
  const Polygons ear = rounded_box({0.10, 0.34, 0.05}, 0.02, 2);
  for (const double z : {-0.62, -0.42, 0.42, 0.62}) out.add(ear, at({-0.12, 0.14, z}));
  return out;
}

/// A bar between two points that move: a barrel from `a` and a rod from `b`, each of which looks at the other.
void cylinder_drive(GalleryBuilder& b, const std::string& name, int parent, int barrel_material, int rod_material,
                    double length, const std::function<Vec3d(double)>& from, const std::function<Vec3d(double)>& to) {
  const auto aim = [](const Vec3d& d) { return about_z(std::atan2(d.y, d.x) * 180 / kPiD); };  // +x along d, in x-y
  const int barrel =
      b.place(name + "_barrel", tube(std::vector<Vec3d>{{0, 0, 0}, {length, 0, 0}}, std::vector<double>{0.065}, 16),
              barrel_material, {}, {}, parent);
  const int rod =
      b.place(name + "_rod", tube(std::vector<Vec3d>{{0, 0, 0}, {length, 0, 0}}, std::vector<double>{0.036}, 16),
              rod_material, {}, {}, parent);
  b.move(barrel, from);
  b.turn(barrel, [=](double f) { return aim(to(f) - from(f)); });
  b.move(rod, to);
  b.turn(rod, [=](double f) { return aim(from(f) - to(f)); });
}

void build(GalleryBuilder& b) {
  const Picture dirt = paint(512, 512, [](double u, double v) {
    const double n = tiled_noise(u, v, 6, 6, 90), pebbles = tiled_noise(u, v, 64, 2, 97);
    return mix(hex("#8b7355"), hex("#5f4d3a"), std::clamp(0.5 + 0.6 * n, 0.0, 1.0)) * float(1 + 0.35 * pebbles);
  });
  const Picture gravel = paint(256, 256, [](double u, double v) {
    return mix(hex("#8c857b"), hex("#57524b"), std::clamp(0.5 + 0.7 * tiled_noise(u, v, 24, 4, 99), 0.0, 1.0));
  });
  const int ground =
      b.material({.name = "ground", .color = Rgb(1.0f), .texture = b.texture("dirt", dirt), .specular = 0});
  const int heap =
      b.material({.name = "gravel", .color = Rgb(1.0f), .texture = b.texture("gravel", gravel), .specular = 0});
  const int yellow = b.material({.name = "yellow", .color = hex("#e3a412"), .roughness = 0.35});
  const int rubber = b.material({.name = "rubber", .color = hex("#232323"), .roughness = 0.85});
  const int gray = b.material({.name = "gray", .color = hex("#3b3d40"), .roughness = 0.5});
  const int steel = b.material({.name = "worn_steel", .color = {0.55f, 0.53f, 0.50f}, .roughness = 0.5, .metallic = 1});
  const int chrome = b.material({.name = "chrome", .color = {0.80f, 0.80f, 0.80f}, .roughness = 0.18, .metallic = 1});
  const int window = b.material({.name = "window", .color = hex("#10181c"), .roughness = 0.05});
  const int lens = b.material({.name = "lens", .color = hex("#e8e4d8"), .roughness = 0.15});
  const int orange = b.material({.name = "orange", .color = hex("#e0571b"), .roughness = 0.3});

  b.place("ground", floor_plane({120, 120}, {48, 48}), ground);
  // A heap of 78 x 78 cells.
  const Polygons mound = sheet(78, 78, [](double u, double v) {
    const double x = (u - 0.5) * 5.2, z = (0.5 - v) * 5.2, r = std::hypot(x, z);
    const double cone = 1.55 * std::max(0.0, 1 - r / 2.45);
    const double rough = 0.14 * fractal_noise({x * 1.7, 1, z * 1.7}, 5, 44);
    return Vec3d{x, cone + (cone > 0 ? rough * smooth_step(2.5, 1.9, r) : 0) - 0.02, z};
  });
  Polygons pile = mound;
  pile.map_uv({6, 6});
  b.place("heap", pile, heap, {6.6, 0, -0.1});

  const int loader = b.group("loader");
  b.move(loader, [](double f) { return Vec3d{kDrive * (f - 1), kWheel, 0}; });
  // Wheels roll: the turn is the way over the radius.
  const int tyre_mesh = b.mesh("tyre", tyre(), rubber), rim_mesh = b.mesh("rim", rim(), yellow);
  for (const double x : {kFront, kRear}) {
    for (const double z : {-kTrack, kTrack}) {
      const std::string id = std::string(x > 0 ? "_front" : "_rear") + (z > 0 ? "_right" : "_left");
      const int hub = b.group("hub" + id, {x, 0, z}, {}, loader);
      b.turn(hub, [=](double f) { return about_z(17 * (x + z) - kDrive * (f - 1) / kWheel * 180 / kPiD); });
      b.place("tyre" + id, tyre_mesh, {}, {}, hub);
      b.place("rim" + id, rim_mesh, {}, {}, hub);
    }
  }

  // Rear body with engine, counterweight and grille; y = 0 is the height of the axles.
  const auto fixed = [&](const char* name, const Polygons& p, int material, const Vec3d& position,
                         const Quatd& turn = {}) { b.place(name, p, material, position, turn, loader); };
  const std::vector<Vec2d> hood{{-2.55, -0.10}, {-0.75, -0.10}, {-0.75, 0.98},
                                {-2.20, 0.90},  {-2.48, 0.74},  {-2.60, 0.35}};
  fixed("hood", extrude(hood, 1.15, 1, 20), yellow, {});
  fixed("counterweight", rounded_box({0.42, 0.62, 1.7}, 0.10, 3), gray, {-2.56, 0.12, 0});
  Polygons grille;
  for (int k = 0; k < 7; ++k) grille.add(box({0.03, 0.035, 0.86}), at({-2.545 + 0.02 * k, 0.47 + 0.05 * k, 0}));
  fixed("grille", grille, gray, {});
  fixed("rear_frame", rounded_box({2.5, 0.30, 0.9}, 0.04, 2), gray, {-1.5, -0.18, 0});
  fixed("front_frame", rounded_box({1.35, 0.42, 0.80}, 0.04, 2), yellow, {1.25, 0.02, 0});
  fixed("joint", cylinder(0.16, -0.42, 0.30, 20, 0.02), steel, {0.25, 0, 0});
  for (const double z : {-kTrack, kTrack}) {
    fixed(z < 0 ? "axle_guard_left" : "axle_guard_right", rounded_box({1.5, 0.05, 0.62}, 0.02, 2), yellow,
          {kRear + 0.1, kWheel + 0.12, z});
    fixed(z < 0 ? "fender_left" : "fender_right", rounded_box({0.06, 0.42, 0.62}, 0.02, 2), yellow,
          {kRear + 0.84, kWheel - 0.06, z});
    Polygons steps;
    for (int k = 0; k < 3; ++k)
      steps.add(rounded_box({0.42, 0.035, 0.24}, 0.012, 1), at({-0.55, -0.32 + 0.36 * k, z * 0.86}));
    fixed(z < 0 ? "ladder_left" : "ladder_right", steps, gray, {});
  }
  fixed("axle_front", capsule({0, 0, -0.8}, {0, 0, 0.8}, 0.14, 0.14, 16), gray, {kFront, 0, 0});
  fixed("axle_rear", capsule({0, 0, -0.8}, {0, 0, 0.8}, 0.14, 0.14, 16), gray, {kRear, 0, 0});
  const Polygons pipe = tube(curve(std::vector<Vec3d>{{0, 0, 0}, {0, 0.45, 0}, {-0.03, 0.60, 0}, {-0.12, 0.66, 0}}, 4),
                             std::vector<double>{0.05}, 16, false);
  fixed("exhaust", pipe, chrome, {-1.55, 0.92, 0.32});

  // Cab: posts and roof around dark glass.
  fixed("cab_glass", rounded_box({1.02, 1.02, 1.06}, 0.03, 2), window, {-0.28, 1.42, 0});
  fixed("cab_base", rounded_box({1.16, 0.55, 1.2}, 0.05, 3), yellow, {-0.28, 0.72, 0});
  fixed("cab_roof", rounded_box({1.32, 0.13, 1.34}, 0.055, 3), yellow, {-0.26, 2.0, 0});
  Polygons posts;
  for (const double x : {-0.81, 0.25})
    for (const double z : {-0.53, 0.53}) posts.add(rounded_box({0.10, 1.06, 0.10}, 0.025, 1), at({x, 1.44, z}));
  posts.add(rounded_box({0.07, 1.06, 0.05}, 0.02, 1), at({-0.42, 1.44, 0.545}));
  posts.add(rounded_box({0.07, 1.06, 0.05}, 0.02, 1), at({-0.42, 1.44, -0.545}));
  fixed("cab_posts", posts, yellow, {});
  for (const double z : {-0.45, 0.45}) {
    fixed(z < 0 ? "lamp_left" : "lamp_right", sphere(0.075, 20, 10), lens, {0.38, 2.06, z});
    fixed(z < 0 ? "headlamp_left" : "headlamp_right", sphere(0.11, 20, 10), lens, {1.92, 0.40, z * 0.75});
  }
  fixed("beacon", capsule({0, 0, 0}, {0, 0.10, 0}, 0.055, 0.05, 16), orange, {-0.62, 2.10, 0.4});

  // Boom and bucket.
  const Vec3d pivot{0.78, 0.92, 0}, tip{2.10, -1.05, 0};  // against the axles, with the boom at angle 0
  const auto boom_angle = [](double f) { return std::clamp(2 * (f - 4), 0.0, 76.0); };
  const auto bucket_angle = [](double f) {
    return -8 + std::clamp(3 * (f - 1), 0.0, 48.0) - std::max(0.0, 3 * (f - 36));
  };
  const auto boom_point = [=](double f, const Vec3d& p) { return pivot + rotation(about_z(boom_angle(f))).vector(p); };
  const int boom = b.group("boom", pivot, {}, loader);
  b.turn(boom, [=](double f) { return about_z(boom_angle(f)); });
  std::vector<Vec2d> outline;
  for (const Vec2d& p :
       curve(std::vector<Vec2d>{{-0.14, -0.02}, {0.35, -0.16}, {0.95, -0.52}, {1.55, -0.92}, {2.02, -1.18}}, 5))
    outline.push_back(p);
  for (const Vec2d& p :
       curve(std::vector<Vec2d>{{2.20, -0.98}, {1.72, -0.58}, {1.10, -0.10}, {0.45, 0.14}, {-0.08, 0.16}}, 5))
    outline.push_back(p);
  Polygons arms;
  for (const double z : {-0.46, 0.46}) arms.add(extrude(outline, 0.11, 1, 35), at({0, 0, z}));
  arms.add(capsule({1.35, -0.62, -0.46}, {1.35, -0.62, 0.46}, 0.09, 0.09, 16));
  arms.add(capsule({0, 0.03, -0.6}, {0, 0.03, 0.6}, 0.07, 0.07, 16));
  b.place("boom_arms", arms, yellow, {}, {}, boom);
  const int wrist = b.group("wrist", tip, {}, boom);
  b.turn(wrist, [=](double f) { return about_z(bucket_angle(f) - 0.75 * boom_angle(f)); });
  b.place("bucket", bucket(), steel, {0.16, 0.10, 0}, {}, wrist);
  b.place("pin", capsule({0, 0, -0.72}, {0, 0, 0.72}, 0.05, 0.05, 16), chrome, {}, {}, wrist);
  for (const double z : {-0.30, 0.30})
    cylinder_drive(
        b, z < 0 ? "lift_left" : "lift_right", loader, yellow, chrome, 0.92,
        [=](double) {
          return Vec3d{1.35, 0.05, z};
        },
        [=](double f) {
          return boom_point(f, {1.30, -0.42, 0}) + Vec3d{0, 0, z};
        });

  b.environment(sky(1024, {0.35, 0.5, 0.75}, 3, 0.3, 3.0));
  const auto eye = [](double f) { return Vec3d{7.9 - 0.1 * (f - 1) * 0.55, 2.05, 8.0 - 0.1 * (f - 1) * 0.835}; };
  b.camera(33, eye, [](double f) { return Vec3d{1.7 + 0.03 * (f - 1), 1.1, 0}; });
}

}  // namespace

extern const GalleryScene loader_scene{
    .name = "loader",
    .title = "A wheel loader drives to a heap of gravel and lifts its bucket under the sky",
    .paper = &kZhou2015,
    .figure = "Figure 4 and Table 1",
    .triangles = 59762,
    .width = 720,
    .height = 480,
    .last_frame = 48,
    .spp = 32,
    .max_depth = 5,
    .reference_spp = 4096,
    .classes = {{"direct", "ED", "direct light of sky and sun"},
                {"indirect", "ED.+", "light by more than one reflection"}},
    .camera_moves = true,
    .moving = {"tyre_front_left", "boom_arms", "bucket", "lift_left_rod", "hood"},
    .about =
        "Camera and objects move, as in the paper: the loader (about 59 000 triangles with its heap) drives 0.05 m a "
        "frame on wheels that roll,\n"
        "the boom rises by 2 degrees a frame, the bucket tips back by 3 and out again, its cylinders follow, and the "
        "camera\n"
        "goes 0.1 m a frame. 32 samples per pixel in the paper.\n",
    .build = build,
};

}  // namespace tempera
