// SPDX-License-Identifier: Apache-2.0
// Mirrors and glass whose motion is known in closed form, for what follows light through them [Zimmer 2015, Sec. 4.1].
#include <fmt/format.h>

#include <cmath>

#include "papers.h"
#include "props.h"

namespace tempera {

using namespace gallery;

namespace {

constexpr double kRadius = 0.8, kSpacing = 2.1;
constexpr int kSegments = 96, kRings = 48;

/// The same surface seen from its other side, as the inner wall of a vessel.
Polygons inside_out(Polygons p) {
  for (Vec3f& n : p.normals) n = -n;
  for (std::size_t i = 0; i + 2 < p.indices.size(); i += 3) std::swap(p.indices[i + 1], p.indices[i + 2]);
  return p;
}

Polygons shell() {
  return sphere(kRadius, kSegments, kRings).add(inside_out(sphere(0.85 * kRadius, kSegments, kRings)));
}

/// Two caps of a ball of 1.2 m, 0.8 m in radius, that face along z.
Polygons lens() {
  constexpr double kCurvature = 1.2;
  const double half = std::asin(kRadius / kCurvature), center = kCurvature * std::cos(half);
  std::vector<Vec2d> profile;
  constexpr int kSteps = 32;
  for (const double side : {-1.0, 1.0}) {
    for (int i = side < 0 ? 0 : 1; i <= kSteps; ++i) {
      const double a = half * (side < 0 ? i : kSteps - i) / kSteps;
      profile.push_back({kCurvature * std::sin(a), side * (kCurvature * std::cos(a) - center)});
    }
  }
  Polygons out;
  return out.add(lathe(profile, kSegments), turned({1, 0, 0}, 90));
}

/// A ball with a displacement that makes it higher. Normals are those of the ellipsoid: they are linear in the weight
/// before they are normalized.
Polygons soft_ball() {
  Polygons out = sphere(kRadius, kSegments, kRings);
  out.targets.resize(1);
  for (std::size_t i = 0; i < out.positions.size(); ++i) {
    out.targets[0].positions.emplace_back(Vec3d{0, out.positions[i].y, 0});
    out.targets[0].normals.emplace_back(Vec3d{out.normals[i].x, 0, out.normals[i].z});
  }
  return out;
}

enum class Stuff { kSilver, kGlass, kSheet };

struct Piece {
  const char* name;
  Stuff stuff;
  Polygons (*shape)();
  double turn;  ///< degrees to both sides of where it stands
  Vec3d axis{0, 1, 0};
};

/// In the order of the picture, row by row.
const Piece kPieces[] = {
    {"mirror-plane", Stuff::kSilver,
     [] {
       return wall_plane({1.6, 1.6});
     },
     4},
    {"mirror-sphere", Stuff::kSilver, [] { return sphere(kRadius, kSegments, kRings); }, 60},
    {"slab", Stuff::kGlass,
     [] {
       return box({1.6, 1.6, 0.5});
     },
     30},
    {"sheet", Stuff::kSheet,
     [] {
       return wall_plane({1.6, 1.6});
     },
     30},
    {"glass-sphere", Stuff::kGlass, [] { return sphere(kRadius, kSegments, kRings); }, 60, {0, 0, 1}},
    {"glass-shell", Stuff::kGlass, shell, 60, {0, 0, 1}},
    {"thick-lens", Stuff::kGlass, lens, 20},
    {"mesh-deform", Stuff::kGlass, soft_ball, 20},
};

/// A chart: squares with letters, so that places can be told.
Picture chart(const char* ground, const char* ink) {
  return paint(512, 512, [&](double u, double v) {
    const double x = u * 8, y = v * 8, fx = x - std::floor(x), fy = y - std::floor(y);
    const char text[] = {char('A' + int(y)), char('1' + int(x)), 0};
    const Rgb square = mix(hex(ground), Rgb(0.75f), checker(x, y) ? 0.45 : 0.0);
    return text_coverage(text, fx * 17 - 3, fy * 17 - 5) > 0 ? hex(ink) : square;
  });
}

/// Pieces before a chart, and another behind the camera for what mirrors show. `alone`: the piece of this index, close.
void fill(GalleryBuilder& b, int alone) {
  // Under light that is 1 from everywhere, colors are reflectances but for what stands in the way.
  const int behind = b.material({.name = "behind",
                                 .color = Rgb(1.0f),
                                 .texture = b.texture("behind", chart("#3d6fa5", "#10202e")),
                                 .specular = 0});
  const int before = b.material({.name = "before",
                                 .color = Rgb(1.0f),
                                 .texture = b.texture("before", chart("#b5652f", "#2e160a")),
                                 .specular = 0});
  // Not all files have all of these, so that exact materials in shot.toml, which must be there, are none.
  const int silver = b.material({.name = "silver", .color = {0.97f, 0.96f, 0.91f}, .roughness = 0, .metallic = 1});
  const int glass = b.material({.name = "glass", .color = Rgb(1.0f), .roughness = 0, .transmission = 1});
  const int sheet =
      b.material({.name = "sheet", .color = Rgb(1.0f), .roughness = 0, .transmission = 1, .solid = false});

  const int back = b.place("wall", wall_plane({18, 12}, {2.4, 1.6}), behind);
  b.move(back, [](double f) { return Vec3d{0.6 * std::sin(2 * kPiD * (f - 1) / 24), 0, -3}; });
  b.place("far_wall", wall_plane({30, 20}, {1.8, 1.2}), before, {0, 0, 14}, about_y(180));

  for (int i = 0; i < int(std::size(kPieces)); ++i) {
    if (alone >= 0 && i != alone) continue;
    const Piece& piece = kPieces[i];
    const int row = i / 4, column = i % 4;
    const Vec3d home = alone >= 0 ? Vec3d{} : Vec3d{(column - 1.5) * kSpacing, (0.5 - row) * kSpacing, 0};
    const int material = piece.stuff == Stuff::kSilver ? silver : piece.stuff == Stuff::kGlass ? glass : sheet;
    const int node = b.place(piece.name, piece.shape(), material);
    const auto phase = [i](double f) { return 2 * kPiD * ((f - 1) / 24 + i / 8.0); };
    b.move(node, [=](double f) {
      const double p = phase(f);
      return home + Vec3d{0.16 * std::sin(p), 0.10 * std::cos(p), 0.12 * std::sin(p + 1)};
    });
    b.turn(node, [=](double f) { return axis_angle(piece.axis, piece.turn * kPiD / 180 * std::cos(phase(f))); });
    if (piece.shape == soft_ball)
      b.morph(node, [=](double f) { return std::vector<double>{0.25 * std::sin(phase(f))}; });
  }
  b.camera(30, {0, 0, alone >= 0 ? 5.0 : 9.0}, {0, 0, 0});
}

void build(GalleryBuilder& b) {
  fill(b, -1);
  for (int i = 0; i < int(std::size(kPieces)); ++i) {
    b.start_file(fmt::format("{}.glb", kPieces[i].name));
    fill(b, i);
  }
  b.environment(Rgb(1.0f));
}

GalleryVariant alone(const char* name, const char* help) {
  return {name, help, {{"scene", fmt::format("\"{}.glb\"", name)}}};
}

}  // namespace

extern const GalleryScene motion_tests_scene{
    .name = "motion-tests",
    .title = "Mirrors and glass of simple shapes that sway and turn before a chart",
    .triangles = 57236,
    .spp = 32,
    .max_depth = 10,
    .reference_spp = 1024,
    .classes = {{"dd", "ED", "the chart, seen directly"},
                {"di", "ED.+", "its indirect light"},
                {"refl", "ERD.*", "what the mirrors and the fronts of glass show"},
                {"trans", "E(T|TT)D.*", "the chart through a sheet or two faces of glass"},
                {"trans4", "ETTTTD.*", "the chart through the four faces of the shell"}},
    .decomposition = true,
    .moving = {"mirror-plane", "mirror-sphere", "slab", "sheet", "glass-sphere", "glass-shell", "thick-lens",
               "mesh-deform", "wall"},
    .variants = {alone("mirror-plane", "a plane mirror: what it shows moves as its virtual image does"),
                 alone("mirror-sphere", "a mirror ball"),
                 alone("slab", "a slab of glass, which shifts what is behind it"),
                 alone("sheet", "a sheet of glass, which passes light straight on"),
                 alone("glass-sphere", "a ball of glass"), alone("glass-shell", "a hollow ball: four refractions"),
                 alone("thick-lens", "a lens of two spherical caps"),
                 alone("mesh-deform", "a ball of glass that deforms")},
    .about =
        "For motion vectors of what mirrors and glass show: each piece is one for which optics has a formula, but the "
        "last, and moves by\n"
        "some pixels a frame; so does the chart behind them. Light comes evenly from everywhere, so that colors are "
        "reflectances and a few\n"
        "samples do. The tests of `libs/chain_motion` check vectors of such pieces against the formulas, with exact "
        "balls in place of\n"
        "meshes. Each variant is one piece, close.\n",
    .build = build,
};

}  // namespace tempera
